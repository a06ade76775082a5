"""The moving line leaves nothing behind when a shorter row takes its place."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any, cast

import pytest
from _pytest._io import TerminalWriter

from pytest_otmcp.plugin.progress import Progress
from pytest_otmcp.suite.catalogue import all_tasks

from .test_runs import screen


@pytest.fixture
def config(monkeypatch: pytest.MonkeyPatch) -> pytest.Config:
    """What the progress asks of pytest, at a terminal."""
    monkeypatch.setenv("TERM", "xterm")
    plugins = {"terminalreporter": SimpleNamespace(isatty=True)}
    return cast(
        pytest.Config,
        SimpleNamespace(
            get_terminal_writer=lambda: TerminalWriter(sys.stdout),
            pluginmanager=SimpleNamespace(getplugin=plugins.get),
            option=SimpleNamespace(verbose=0),
        ),
    )


def finished(name: str, status: str, seconds: float = 0.0) -> Any:
    """Return an item that took so long, behind a start of devices that took a minute."""
    timing = {"plant start": 60_000.0, "tool calls": seconds * 1e3}
    suite = all_tasks()[name].suite
    return {
        "id": name,
        "suite": suite,
        "status": status,
        "title": "",
        "planned": 1,
        "reason": None,
        "timing_ms": timing,
        "around": [],
    }


def test_a_row_of_what_does_not_apply_is_not_written_into_the_moving_line(
    capsys: pytest.CaptureFixture[str], config: pytest.Config
) -> None:
    task = all_tasks()["ENV-001.modbus"]
    progress = Progress(config, [task], {"requirements": 1})
    progress.show_repetition(task, 0, 1)
    progress.show_waiting(task, 42.3, "call 17, 3 s for the reply to read_holding")
    progress.show_finished(finished(task.id, "NOT_APPLICABLE"), cast(Any, None))
    told = capsys.readouterr().out
    assert "item 1 of 1, about 3 s to go" in told
    assert "42 s, longer than expected, call 17, 3 s for the reply" in told
    assert screen(told)[-1] == f"  n/a            {task.id}"


def test_the_rest_is_estimated_by_what_was_measured_here_and_counts_only_what_applies(
    capsys: pytest.CaptureFixture[str], config: pytest.Config
) -> None:
    tasks = [all_tasks()[name] for name in ("ENV-001.mqtt", "ENV-001.modbus", "ENV-002.modbus", "RES-003.modbus")]
    progress = Progress(config, tasks, {"requirements": 1}, inapplicable=["ENV-001.mqtt"])
    progress.show_finished(finished("ENV-001.mqtt", "NOT_APPLICABLE"), cast(Any, None))
    measured: Any = {"passed": 1, "median_ms": None}
    progress.show_finished(finished("ENV-001.modbus", "PASS", seconds=15.0), measured)
    capsys.readouterr()
    progress.show_repetition(tasks[2], 0, 1)
    progress.show_waiting(tasks[2], 40.0, "call 3")
    progress.show_waiting(tasks[2], 50.0, "call 4")
    told = capsys.readouterr().out
    assert "item 2 of 3, about 30 s to go" in told
    assert "40 s, call 3" in told
    assert "50 s, longer than expected, call 4" in told
