"""A vendor's repository for a test: files in a directory, pytest in a process of its own, and the outcome."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pytest_otmcp.record import load
from pytest_otmcp.soundness.warm_start import WarmStart
from tests.reference_text import reference_text

__all__ = ["OUTSIDE", "PATIENCE_S", "WAITING", "Outcome", "Repository", "port_of"]

PATIENCE_S = 120.0
"""The longest wait for an event that must come."""

WAITING = Path(__file__).with_name("waiting.py")
"""A Modbus adapter that waits in the middle of a call."""

OUTSIDE = 'isolation = { network = "host", reason = "it waits until the test lets it go on" }\n'
"""A line of a subject file for an adapter that connects to the test."""

_DEFECTIVE = Path(__file__).parents[1] / "soundness" / "defective.py"
_UNDRAWN = Path(__file__).parent / "undrawn"
_ADAPTER = """
[subject]
name = "a vendor's adapter"
version = "1.0"

[adapter.modbus]
command = {command}
env = {{ MODBUS_HOST = "{{host}}", MODBUS_PORT = "{{port}}", MODBUS_TIMEOUT_S = "4", MODBUS_DEADLINE_S = "25" }}
rw = {{ env = {{ MODBUS_WRITES_ENABLED = "true" }} }}
deadline_s = 30
"""


def port_of(listener: socket.socket) -> str:
    """Return the port of a listening socket as an argument of a program."""
    return str(listener.getsockname()[1])


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Outcome:
    """The outcome of one pytest run in the repository."""

    code: int
    output: str
    report: Path

    def __repr__(self) -> str:
        """Say what a failed assertion has to say: pytest prints no more than some 200 characters of this."""
        with suppress(Exception):
            for item in self.record["items"]:
                if item["status"] == "KIT_ERROR":
                    return f"<{self.code} {item['id']} {item['findings'][0]['message'][:180]}>"
        return f"<{self.code} {self.output[-180:]}>"

    @property
    def record(self) -> dict[str, Any]:
        """The run record, complete or not."""
        return load(self.report / "run.json", allow_incomplete=True)

    @property
    def narrowed(self) -> list[str]:
        """The record's sentences about what narrowed or shadowed the suite."""
        sentences: list[str] = self.record["settings"]["narrowed"]
        return sentences

    @property
    def statuses(self) -> dict[str, str]:
        """The status of each item, by its id."""
        return {item["id"]: item["status"] for item in self.record["items"]}

    @property
    def verdict(self) -> str:
        """The footer's verdict."""
        return str(self.record["footer"]["verdict"])


class Repository:
    """A directory with a vendor's files.

    Args:
        root: the directory.
        warm_start: starts the adapters of its subjects.
    """

    def __init__(self, root: Path, warm_start: WarmStart) -> None:
        self.root = root
        self._warm_start = warm_start

    def write(self, **files: str) -> None:
        """Write files; ``conftest_py`` stands for ``conftest.py``, ``tests__test_own_py`` for ``tests/test_own.py``."""
        for name, content in files.items():
            path = self.root / ".".join(name.replace("__", "/").rsplit("_", 1))
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(content)

    def subject(self, *arguments: str, program: Path = _DEFECTIVE, more: str = "") -> None:
        """Write an ``otmcp.toml`` for a Modbus adapter.

        Args:
            arguments: arguments of the program; by default those for the adapter without a defect.
            program: the adapter; by default the program that has the defect that its argument names.
            more: a text to append to the file.
        """
        command = json.dumps([*self._warm_start.python, str(program), *(arguments or ("none",))])
        self.write(otmcp_toml=_ADAPTER.format(command=command) + (OUTSIDE if program == WAITING else "") + more)

    def reference_subject(self) -> None:
        """Write an ``otmcp.toml`` for the reference adapters that every run has."""
        text = reference_text()
        started, warm = '["{python}", ', json.dumps(self._warm_start.python)[:-1] + ", "
        assert started in text
        self.write(otmcp_toml=text.replace(started, warm))

    def command(self, *options: str, plugins: str | None = "", drawn: bool = False) -> list[str]:
        """Return the command that :meth:`pytest` runs."""
        names = [] if plugins is None else ["pytest_otmcp.plugin", *plugins.split()]
        if not drawn:
            names.append("undrawn")
        loaded = [part for name in names for part in ("-p", name)]
        return [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *loaded, *options]

    def environment(self, *, plugins: str | None = "", path: tuple[Path, ...] = ()) -> dict[str, str]:
        """Return the environment in which :meth:`pytest` runs its command."""
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (*path, _UNDRAWN)))}
        if plugins is not None:
            environment["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
        return environment

    def pytest(
        self, *options: str, plugins: str | None = "", path: tuple[Path, ...] = (), drawn: bool = False
    ) -> Outcome:
        """Run ``pytest`` with these options here.

        Args:
            plugins: names of the plugins to load besides this one, separated by blanks; None for all that are
                installed, as it is for a vendor.
            path: directories in which modules are found.
            drawn: the report has its figures, which take longer than most runs.
        """
        done = subprocess.run(
            self.command(*options, plugins=plugins, drawn=drawn),
            cwd=self.root,
            capture_output=True,
            text=True,
            timeout=900,
            check=False,
            env=self.environment(plugins=plugins, path=path),
        )
        return self.outcome(done.returncode, done.stdout + done.stderr)

    def outcome(self, code: int, output: str) -> Outcome:
        """Return the outcome of a run that ended with this exit code and output."""
        return Outcome(code=code, output=output, report=self.root / "reports" / "latest")

    def collected(self, *options: str, plugins: str | None = "") -> list[str]:
        """Return the names of the items that pytest would run."""
        outcome = self.pytest("--collect-only", "-q", *options, plugins=plugins)
        return [line.rpartition("::")[2] for line in outcome.output.splitlines() if "::" in line]
