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


def test_a_row_of_what_does_not_apply_is_not_written_into_the_moving_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    plugins = {"terminalreporter": SimpleNamespace(isatty=True)}
    config = SimpleNamespace(
        get_terminal_writer=lambda: TerminalWriter(sys.stdout),
        pluginmanager=SimpleNamespace(getplugin=plugins.get),
        option=SimpleNamespace(verbose=0),
    )
    task = all_tasks()["ENV-001.modbus"]
    progress = Progress(cast(pytest.Config, config), [task], {"requirements": 1})
    progress.show_repetition(task, 0, 1)
    progress.show_waiting(task, 42.3, "call 17, 3 s for the reply to read_holding")
    item: Any = {"id": task.id, "suite": task.suite, "status": "NOT_APPLICABLE"}
    progress.show_finished(item, cast(Any, None))
    told = capsys.readouterr().out
    assert "item 1 of 1, about 1 s to go" in told
    assert "42 s, longer than expected, call 17, 3 s for the reply" in told
    assert screen(told)[-1] == f"  n/a            {task.id}"
