"""A run that is started from the page is followed to its end, whatever its process does."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.console.runs import Runs
from pytest_otmcp.subject import reference_subject


class Started:
    """Runs whose command is another one, and what they have told."""

    def __init__(self, directory: Path, *command: str) -> None:
        self.told: list[Any] = []
        self.records: list[Path] = []
        self.runs = Runs([reference_subject()], "auto", directory, self.told.append, self.records.append)
        self.runs._command = lambda *_: list(command)  # type: ignore[method-assign]

    async def start(self) -> None:
        await self.runs.start(0, ["stress"], 1)

    async def end(self) -> Sequence[str]:
        """Wait for the end of the run and return the lines that it has printed."""
        async with asyncio.timeout(300):
            if self.runs._watching is not None:
                await self.runs._watching
        assert self.told[-1]["running"] is False
        return [event["line"] for event in self.told if event["kind"] == "line"]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_long_line_is_a_line(tmp_path: Path) -> None:
    async def run() -> None:
        started = Started(tmp_path, sys.executable, "-c", "print('x' * 200_000); print('end')")
        await started.start()
        assert await started.end() == ["x" * 200_000, "end"]

    asyncio.run(run())


def test_a_run_that_cannot_be_followed_is_over_and_its_process_ends(tmp_path: Path) -> None:
    async def run() -> None:
        endless = "import sys\nwhile True: sys.stdout.write('x' * 65536)"
        started = Started(tmp_path, sys.executable, "-c", endless)
        await started.start()
        [line] = await started.end()
        assert line.startswith("the run cannot be followed: ")
        lost = Started(tmp_path, "no-such-program")
        await lost.start()
        [line] = await lost.end()
        assert line.startswith("the run cannot be followed: [Errno 2]")
        await lost.start()
        await lost.end()

    asyncio.run(run())


def test_a_run_is_stopped_before_its_process_exists(tmp_path: Path) -> None:
    async def run() -> None:
        started = Started(tmp_path, "sleep", "300")
        await started.start()
        await started.runs.stop()
        assert started.runs.state()["running"] is False

    asyncio.run(run())
