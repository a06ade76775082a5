"""Runs of the suite, started from the page and watched row by row: a process as on the command line, one at a time.

The page chooses a subject by its number, suites by their names, and a number of repetitions; the command line is made here.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from pathlib import Path

from ..core.errors import UsageError
from ..core.matrix import SUITES
from ..subject import reference_subject
from ..subject.model import Subject
from .feed import Event

__all__ = ["Runs"]

_MOST_REPS = 30
"""Repetitions of the paper's matrix."""

_GRACE_S = 60.0
"""Time that an interrupted run has to end its adapters and devices; then it is killed, and its keeper ends the rest."""

_LONGEST_LINE = 1 << 24
"""Bytes: pytest prints what an assertion compares in one line."""

_FOLDER = "reports/console-{}"


class Runs:
    """The run that is under way, or the last one.

    Args:
        isolation: the mode of walls, as on the command line.
        directory: of the console, for what a run needs beside its report.
        tell: is given the events.
        ended: is given the record of a run that is over.
    """

    def __init__(
        self,
        subjects: Sequence[Subject],
        isolation: str,
        directory: Path,
        tell: Callable[[Event], None],
        ended: Callable[[Path], None],
    ) -> None:
        self._subjects = subjects
        self._isolation = isolation
        self._directory = directory
        self._tell = tell
        self._ended = ended
        self._process: asyncio.subprocess.Process | None = None
        self._watching: asyncio.Task[None] | None = None
        self._begun = asyncio.Event()
        self._lines: list[str] = []

    def state(self) -> Event:
        """Return what there is to choose from, and what the run has said so far."""
        return {
            "kind": "run",
            "subjects": [f"{subject.name} {subject.version}" for subject in self._subjects],
            "suites": [*SUITES],
            "running": self._watching is not None,
            "lines": self._lines,
        }

    async def start(self, number: int, suites: Collection[str], reps: int) -> None:
        """Start a run.

        Raises:
            UsageError: one is under way, or what is chosen is not there.
        """
        if self._watching is not None:
            raise UsageError("a run is under way; it can be stopped")
        if number not in range(len(self._subjects)) or not suites or not {*suites} <= {*SUITES}:
            raise UsageError("choose an adapter and a suite")
        if reps not in range(1, _MOST_REPS + 1):
            raise UsageError(f"a run from here has 1 to {_MOST_REPS} repetitions")
        folder = next(path for count in range(1, sys.maxsize) if not (path := Path(_FOLDER.format(count))).exists())
        self._lines.clear()
        self._begun = asyncio.Event()
        self._watching = asyncio.create_task(self._watch(self._command(number, suites, reps, folder), folder))

    def _command(self, number: int, suites: Collection[str], reps: int, folder: Path) -> list[str]:
        ini = self._directory / "pytest.ini"
        ini.write_text("[pytest]\n", encoding="utf-8")
        subject = self._subjects[number].source
        named = [] if subject == reference_subject().source else [f"--otmcp-subject={subject.absolute()}"]
        return [
            *(sys.executable, "-P", "-m", "pytest", "-c", str(ini), f"--rootdir={Path.cwd()}", "--noconftest"),
            *("-rN", "--color=no", "-p", "no:cacheprovider", "-p", "pytest_otmcp.plugin", "--pyargs"),
            "pytest_otmcp.conformance",
            *(f"--otmcp-suite={','.join(suites)}", f"--otmcp-reps={reps}", f"--otmcp-report-dir={folder}"),
            *(f"--otmcp-isolation={self._isolation}", *named),
        ]

    async def _watch(self, command: Sequence[str], folder: Path) -> None:
        """Follow a run, and say what has come of it, however that ends."""
        try:
            await self._follow(command)
        except (OSError, ValueError) as error:
            self._add(f"the run cannot be followed: {error}")
        finally:
            process, self._process, self._watching = self._process, None, None
            self._begun.set()
            if process is not None and process.returncode is None:
                process.kill()
                await process.communicate()
            record = folder / "run.json"
            if record.is_file():
                self._ended(record)
            self._tell(self.state())

    def _add(self, line: str) -> None:
        self._lines.append(line)
        self._tell({"kind": "line", "line": line})

    async def _follow(self, command: Sequence[str]) -> None:
        environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}
        # A session of its own: otherwise Ctrl-C in a terminal would reach it a second time, while it closes.
        self._process = process = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env=environment,
            start_new_session=True,
            limit=_LONGEST_LINE,
        )
        self._begun.set()
        assert process.stdout is not None
        self._tell(self.state())
        while line := await process.stdout.readline():
            self._add(line.decode("utf-8", "replace").rstrip("\n"))
        await process.wait()

    async def stop(self) -> None:
        """Interrupt the run, if there is one, and wait for its end."""
        watching = self._watching
        if watching is None:
            return
        await self._begun.wait()
        if (process := self._process) is None:
            return
        with suppress(ProcessLookupError):
            process.send_signal(signal.SIGINT)
        if not (await asyncio.wait({watching}, timeout=_GRACE_S))[0]:
            with suppress(ProcessLookupError):
                process.kill()
            await asyncio.wait({watching})
