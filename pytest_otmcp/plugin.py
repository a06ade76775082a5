"""pytest hooks only: options, markers, order of items, progress, record, summary, exit code, pytest-xdist.

Without conformance items in a run the plugin does nothing and imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import pytest

from .errors import UsageError
from .fixtures import otmcp_trial
from .keys import LIVE, RECORDER, REQUIRED, RESULT, RUN, SETTINGS
from .settings import add_options, read_settings
from .task import SUITES, Task

__all__ = ["otmcp_trial"]

_FACTS = "otmcp_facts"
_RESULT = "otmcp_result"


def pytest_addoption(parser: pytest.Parser) -> None:
    add_options(parser)


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "otmcp: a conformance item of pytest-otmcp")
    for suite in SUITES:
        config.addinivalue_line("markers", f"otmcp_{suite}: an item of the {suite} suite")
    for family in ("modbus", "mqtt", "opcua", "cross"):
        config.addinivalue_line("markers", f"otmcp_{family}: an item of this family of adapters")
    try:
        config.stash[SETTINGS] = read_settings(config)
    except UsageError as error:
        raise pytest.UsageError(str(error)) from None


def _task(item: pytest.Item) -> Task | None:
    callspec = getattr(item, "callspec", None)
    task = callspec.params.get("task") if callspec is not None else None
    return task if isinstance(task, Task) else None


def _family_marker(task: Task) -> str:
    return "otmcp_cross" if task.family == "Cross-protocol" else f"otmcp_{task.adapters[0]}"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(session: pytest.Session, config: pytest.Config, items: list[pytest.Item]) -> None:
    tasks = {item: task for item in items if (task := _task(item)) is not None}
    if not tasks:
        return
    for item, task in tasks.items():
        item.add_marker("otmcp")
        item.add_marker(f"otmcp_{task.suite}")
        item.add_marker(_family_marker(task))
    config.stash[REQUIRED] = [task.id for task in tasks.values()]
    # The suites run in the paper's order, among themselves: other tests stay where they are.
    ordered = iter(sorted(tasks, key=lambda item: SUITES.index(tasks[item].suite)))
    items[:] = [next(ordered) if item in tasks else item for item in items]
    suites = config.stash[SETTINGS].suites
    deselected = [item for item, task in tasks.items() if task.suite not in suites]
    if deselected:
        config.hook.pytest_deselected(items=deselected)
        items[:] = [item for item in items if item not in deselected]


@pytest.hookimpl(trylast=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    config = session.config
    tasks = [task for item in session.items if (task := _task(item)) is not None]
    if not tasks or config.option.collectonly:
        return
    from .run import Run
    from .subject import load_subject, reference_subject

    settings = config.stash[SETTINGS]
    try:
        subject = reference_subject() if settings.subject is None else load_subject(settings.subject)
    except UsageError as error:
        raise pytest.UsageError(str(error)) from None
    run = config.stash[RUN] = Run(settings, subject, tasks)
    if not _is_worker(config):
        _begin_recording(config, run, workers=0)
    live = config.stash.get(LIVE, None)
    if live is not None:
        run.progress = live.repetition


def _is_worker(config: pytest.Config) -> bool:
    return hasattr(config, "workerinput")


def _begin_recording(config: pytest.Config, run: Any, *, workers: int) -> None:
    from .live import Live
    from .run import Recorder

    recorder = config.stash[RECORDER] = Recorder(run.settings, run.subject, workers=workers)
    recorder.required = config.stash.get(REQUIRED, [task.id for task in run.tasks])
    config.stash[LIVE] = Live(config, run.tasks, run.settings.repetitions)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_node_collection_finished(node: Any, ids: list[str]) -> None:
    """The controller collects nothing itself; it learns of conformance items from its first worker."""
    config = node.config
    if RECORDER in config.stash or not any("[" in identifier for identifier in ids):
        return
    from .run import Run
    from .shipped import tasks_by_id
    from .subject import load_subject, reference_subject

    known = tasks_by_id()
    wanted = [known[name] for identifier in ids if (name := identifier.rpartition("[")[2].rstrip("]")) in known]
    if not wanted:
        return
    settings = config.stash[SETTINGS]
    subject = reference_subject() if settings.subject is None else load_subject(settings.subject)
    config.stash[REQUIRED] = list(known)
    _begin_recording(config, Run(settings, subject, wanted), workers=config.getoption("numprocesses") or 1)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    result = item.stash.get(RESULT, None)
    if result is not None and report.when == "call":
        # Plain attributes with JSON-safe values survive the way from an xdist worker to the controller.
        setattr(report, _RESULT, result)
        setattr(report, _FACTS, item.config.stash[RUN].facts())
    return report


@pytest.hookimpl(trylast=True)
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    result = getattr(report, _RESULT, None)
    config = _CONTROLLER.get("config")
    if result is None or config is None or RECORDER not in config.stash:
        return
    worker = getattr(getattr(report, "node", None), "gateway", None)
    config.stash[RECORDER].add(result, worker.id if worker is not None else "main", getattr(report, _FACTS))
    config.stash[LIVE].finished(result)


_CONTROLLER: dict[str, pytest.Config] = {}
"""pytest_runtest_logreport is not told the config; this is the one of the controller of this process."""


def pytest_sessionstart(session: pytest.Session) -> None:
    if not _is_worker(session.config):
        _CONTROLLER["config"] = session.config


@pytest.hookimpl(tryfirst=True)
def pytest_report_teststatus(report: pytest.TestReport, config: pytest.Config) -> tuple[str, str, str] | None:
    if getattr(report, _RESULT, None) is not None:
        # The line of the item says it; no letter beside it.
        return report.outcome, "", ""
    return None


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    config = session.config
    run = config.stash.get(RUN, None)
    recorder = config.stash.get(RECORDER, None)
    if run is not None:
        if recorder is not None and run.unfinished is not None:
            recorder.add(run.unfinished, "main", run.facts())
        run.facts()
        run.close()
    if recorder is None:
        return
    from .verdict import Verdict

    recorder.finish(interrupted=exitstatus == pytest.ExitCode.INTERRUPTED)
    if recorder.verdict in (Verdict.NOT_CONFORMANT, Verdict.INDETERMINATE) and exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: Any, exitstatus: int, config: pytest.Config) -> None:
    recorder = config.stash.get(RECORDER, None)
    if recorder is None or not recorder.results:
        return
    from .report.render import render

    render(recorder.path, terminalreporter, config.rootpath)


def pytest_unconfigure(config: pytest.Config) -> None:
    if _CONTROLLER.get("config") is config:
        _CONTROLLER.clear()
