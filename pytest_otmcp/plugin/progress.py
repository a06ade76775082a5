"""Progress of a run on the terminal: a row for each finished item, and a moving line for what is under way.

pytest's own verbosity decides: with ``-v`` the rows are pytest's, with ``-q`` there are its letters alone.
"""

from __future__ import annotations

import os
import time
from collections import defaultdict
from collections.abc import Collection
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

from ..core.text import counted
from ..report import control_failed
from ..report.text import shortened

if TYPE_CHECKING:
    import pytest

    from ..record.schema import ItemBody
    from ..trial.task import Task
    from .results import ItemResult, Measured

__all__ = ["Progress", "verbose_word"]

# Seconds per repetition, until items of the suite have been measured here. A check's are the median of five records of the field report.
_GUESS_S = {"normal": 0.02, "fault": 0.02, "stress": 0.12, "recovery": 1.3, "requirements": 3.0, "field": 1.0}
_STARTS = ("plant start", "adapter starts")
_LATE, _LATE_S = 3, 20.0
"""An item that takes so many times as long as was guessed, and so many seconds, is said to take longer than expected."""

_REDRAW_S = 0.1
_MOVING_WIDTH = 90
_EDGE = len(" [100%]") + 2
"""Columns to leave free: text nearer to the edge would make pytest print its percentage there and begin another line."""


class Progress:
    """Display of progress on pytest's own terminal.

    Args:
        tasks: tasks of all items to run.
        inapplicable: ids of those that do not apply to the subject: they take no time and are not counted.
        repetitions: suite name to number of repetitions.
        workers: number of pytest-xdist workers, 0 for none; latencies of a parallel run are not shown.
    """

    def __init__(
        self,
        config: pytest.Config,
        tasks: list[Task],
        repetitions: dict[str, int],
        *,
        inapplicable: Collection[str] = (),
        workers: int = 0,
    ) -> None:
        self._writer = config.get_terminal_writer()
        self._capture: Any = config.pluginmanager.getplugin("capturemanager")
        self._shown = config.option.verbose == 0
        # Without colours, as with NO_COLOR, a terminal is still a terminal.
        terminal: Any = config.pluginmanager.getplugin("terminalreporter")
        self._moving = self._shown and bool(terminal.isatty) and os.environ.get("TERM") != "dumb"
        applying = [task for task in tasks if task.id not in inapplicable]
        self._suites = {task.id: task.suite for task in applying}
        self._guess = {task.id: _GUESS_S[task.suite] * repetitions.get(task.suite, 1) for task in applying}
        self._total = len(applying)
        # Of each suite the seconds that its finished items were guessed to take, and took: with set-up, controls and new sessions.
        self._guessed, self._took = defaultdict[str, float](float), defaultdict[str, float](float)
        self._workers = workers or 1
        self._id_width = max((len(task.id) for task in tasks), default=0)
        self._digits = len(str(max(repetitions.values())))
        self._timed = not workers
        self._done = 0
        self._drawn = 0.0
        self._line_open = False
        self._row_of_inapplicable = 0
        self._suite = self._heading = ""
        if workers and self._shown:
            self._write(f"each of {counted(workers, 'worker')} starts devices and adapters of its own\n")

    def show_suite(self, suite: str) -> bool:
        """Show the name of the suite that begins, if it is another one; return whether this display has headings at all.

        pytest's own is the path of the file, which is long where the kit is installed. With workers suites are mixed.
        """
        if not self._shown or not self._timed:
            return False
        if suite != self._heading:
            self._heading = suite
            self._begin_row()
            self._write(f"{suite} suite")
        return True

    def show_start(self, done: int, devices: int, adapters: int) -> None:
        """Show how many of the devices and adapters are running; where no line can move, only that they start."""
        if not self._shown or (done and not self._moving):
            return
        text = f"  starting {counted(devices, 'device')} and {counted(adapters, 'adapter')}"
        if self._moving:
            self._draw(f"{text} ({done} of {devices + adapters})")
        else:
            self._write(f"\n{text}")

    def show_repetition(self, task: Task, done: int, planned: int) -> None:
        """Show that a repetition of a task begins."""
        now = time.monotonic()
        if not self._moving or now - self._drawn < _REDRAW_S:
            return
        self._drawn = now
        rest = self._estimate_rest(task, done, planned)
        self._draw(f"  {task.id:<{self._id_width}} {done}/{planned}   item {self._done + 1} of {self._total}, {rest}")

    def show_waiting(self, task: Task, seconds: float, words: str) -> None:
        """Show how long an item has been measured by now, and what it waits for."""
        if self._moving:
            late = "" if seconds < max(_LATE * self._expected(task.id), _LATE_S) else ", longer than expected"
            place = f"item {self._done + 1} of {self._total}"
            self._draw(f"  {task.id:<{self._id_width}} {seconds:.0f} s{late}, {words}   {place}")

    def _draw(self, text: str) -> None:
        if not self._line_open:
            self._write("\n")
        width = min(_MOVING_WIDTH, self._edge())
        self._overwrite(text[:width].ljust(width))
        self._line_open = True

    def _edge(self) -> int:
        with self._uncaptured():
            # The terminal cannot be asked for its width through a stream that is captured.
            return self._writer.fullwidth - 1

    def _estimate_rest(self, task: Task, done: int, planned: int) -> str:
        remaining = sum(map(self._expected, self._guess)) - self._expected(task.id) * done / planned
        minutes, seconds = divmod(round(remaining), 60)
        return f"about {minutes} min {seconds} s to go" if minutes else f"about {seconds} s to go"

    def _expected(self, identifier: str) -> float:
        """Return the seconds that an item is expected to take, by those of its suite that have ended."""
        suite = self._suites.get(identifier, "")
        rate = self._took[suite] / self._guessed[suite] if self._guessed[suite] else 1.0
        return self._guess.get(identifier, 0.0) * rate

    def show_finished(self, item: ItemBody, measured: Measured) -> None:
        """Show the result of a finished item; those that do not apply share rows."""
        if (guess := self._guess.pop(item["id"], None)) is not None:
            self._done += 1
            self._guessed[item["suite"]] += guess
            self._took[item["suite"]] += _took_s(item) / self._workers
        if not self._shown:
            return
        if item["status"] == "NOT_APPLICABLE":
            from ..trial.applicability import NO_ADAPTER

            if (item["reason"] or "").startswith(NO_ADAPTER):
                # A protocol that the subject does not speak is nobody's concern here.
                return
            if item["suite"] != self._suite:
                # pytest has written the name of another file.
                self._row_of_inapplicable = 0
            self._suite = item["suite"]
            self._show_inapplicable(item["id"])
            return
        self._begin_row()
        colour = "green" if item["status"] == "PASS" else "red"
        begin = f"  {item['id']:<{self._id_width}} "
        passed = f"{measured['passed']:>{self._digits}}/{item['planned']}"
        result = f"{passed:<{2 * self._digits + 1}} {item['status']:<4}"
        rest = f" {_title(item, measured)}" if not self._timed else f" {_median(measured)}  {_title(item, measured)}"
        self._write(begin)
        self._write(result, **{colour: True})
        self._write(shortened(rest, self._writer.fullwidth - _EDGE - len(begin) - len(result)))

    def _show_inapplicable(self, identifier: str) -> None:
        room = self._writer.fullwidth - _EDGE - self._row_of_inapplicable
        if not self._row_of_inapplicable or self._line_open or room < len(identifier) + 1:
            self._begin_row()
            self._write(begin := f"  {'n/a':<{self._id_width}}", yellow=True)
            self._row_of_inapplicable = len(begin)
        self._write(f" {identifier}", yellow=True)
        self._row_of_inapplicable += len(identifier) + 1

    def _begin_row(self) -> None:
        self._row_of_inapplicable = 0
        if self._line_open:
            # A row may be shorter than the moving line.
            self._overwrite(" " * min(_MOVING_WIDTH, self._edge()))
            self._overwrite("")
        else:
            self._write("\n")
        self._line_open = False

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


def _took_s(item: ItemBody) -> float:
    """Return the seconds that an item took, without the start of devices and adapters, which later items find running."""
    return sum(ms for what, ms in item["timing_ms"].items() if what not in _STARTS) / 1e3


def _title(item: ItemBody, measured: Measured) -> str:
    failed = "failed beside the repetitions: " if control_failed(item, measured["passed"]) else ""
    return f"{failed}{item['title']}"


def _median(measured: Measured) -> str:
    median_ms = measured["median_ms"]
    return " " * 11 if median_ms is None else f"{median_ms:8.2f} ms"


def verbose_word(result: ItemResult) -> str:
    """Return what pytest writes behind the name of an item with ``-v``."""
    item, measured = result["item"], result["measured"]
    if item["status"] == "NOT_APPLICABLE":
        return "n/a"
    failed = ", failed beside the repetitions" if control_failed(item, measured["passed"]) else ""
    return f"{item['status']} {measured['passed']}/{item['planned']}{failed}"
