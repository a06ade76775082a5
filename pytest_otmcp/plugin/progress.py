"""Progress of a run on the terminal: one line for each finished item, and a moving line for the item that runs."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

from ..report.text import shortened

if TYPE_CHECKING:
    import pytest

    from ..record.schema import ItemBody
    from ..trial.task import Task
    from .results import Measured

__all__ = ["Progress"]

# Rough seconds per repetition, to guess the remaining time; nothing better is known of items that have not run.
_GUESS_S = {"normal": 0.02, "fault": 0.02, "stress": 0.12, "recovery": 1.3}
_REDRAW_S = 0.1


class Progress:
    """Display of progress on pytest's own terminal.

    Args:
        tasks: tasks of all items to run.
        repetitions: suite name to number of repetitions.
    """

    def __init__(self, config: pytest.Config, tasks: list[Task], repetitions: dict[str, int]) -> None:
        self._writer = config.get_terminal_writer()
        self._capture: Any = config.pluginmanager.getplugin("capturemanager")
        self._quiet = config.option.verbose < -1
        self._moving = bool(self._writer.hasmarkup)
        self._guess = {task.id: _GUESS_S[task.suite] * repetitions[task.suite] for task in tasks}
        self._total = len(tasks)
        self._done = 0
        self._begun = time.monotonic()
        self._drawn = 0.0
        self._line_open = False

    def show_repetition(self, task: Task, done: int, planned: int) -> None:
        """Show that a repetition of a task begins."""
        now = time.monotonic()
        if not self._moving or self._quiet or now - self._drawn < _REDRAW_S:
            return
        self._drawn = now
        rest = self._estimate_rest(task, done, planned)
        text = f"  {task.id:<9} {done}/{planned}   item {self._done + 1} of {self._total}, {rest}"
        if not self._line_open:
            self._write("\n")
        self._overwrite(text[: self._writer.fullwidth - 1].ljust(70))
        self._line_open = True

    def _estimate_rest(self, task: Task, done: int, planned: int) -> str:
        remaining = sum(self._guess.values()) - self._guess.get(task.id, 0.0) * done / planned
        minutes, seconds = divmod(round(remaining), 60)
        return f"about {minutes} min {seconds} s to go" if minutes else f"about {seconds} s to go"

    def show_finished(self, item: ItemBody, measured: Measured) -> None:
        """Show the result of a finished item."""
        self._guess.pop(item["id"], None)
        self._done += 1
        if self._quiet:
            return
        good, median_ms = measured["passed"], measured["median_ms"]
        median = " " * 11 if median_ms is None else f"{median_ms:8.2f} ms"
        colour = {"PASS": "green", "NOT_APPLICABLE": "yellow"}.get(item["status"], "red")
        if self._line_open:
            self._overwrite("")
        else:
            self._write("\n")
        self._line_open = False
        self._write(f"  {item['id']:<9} ")
        self._write(f"{good:>3}/{item['planned']:<3} {item['status']:<5}", **{colour: True})
        # Text near the edge would make pytest print its percentage there and begin another line.
        self._write(shortened(f" {median}  {item['title']}", max(20, self._writer.fullwidth - 36)))

    def _write(self, text: str, **markup: bool) -> None:
        with self._uncaptured():
            self._writer.write(text, flush=True, **markup)

    def _overwrite(self, text: str) -> None:
        # This bypasses pytest's writer, which takes a line with a carriage return for one of no width and would put its
        # percentage beyond the edge.
        with self._uncaptured():
            print("\r" + text, end="", flush=True)

    def _uncaptured(self) -> AbstractContextManager[None]:
        # pytest captures standard output for the running test; progress is written past the capture.
        return nullcontext() if self._capture is None else self._capture.global_and_fixture_disabled()
