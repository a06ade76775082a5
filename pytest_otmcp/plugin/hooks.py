"""pytest hooks only: options, markers, order of items, progress, record, summary, exit code, pytest-xdist.

Without conformance items in a run the plugin does nothing and imports nothing heavy.
"""

from __future__ import annotations

import json
import time
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import pytest

from ..core.errors import UsageError
from ..core.matrix import SUITES
from ..protocols.own import OWN
from ..protocols.registry import protocol_keys
from .collection import (
    SUITE,
    ShippedModule,
    is_shipped,
    names_shipped,
    names_suite,
    quiet,
    suite_by_default,
    task_of,
)
from .fixtures.definitions import (
    REFUSED,
    otmcp_device,
    otmcp_resources,
    otmcp_session,
    otmcp_subject,
    otmcp_trial,
)
from .options import add_options, read_settings
from .stash import INTERFERENCE, PLANNED, PROGRESS, RECORDER, RESULT, RUN, SETTINGS, STARTED

if TYPE_CHECKING:
    from ..trial.task import Task

__all__ = [
    "otmcp_device",
    "otmcp_resources",
    "otmcp_session",
    "otmcp_subject",
    "otmcp_trial",
    "pytest_addoption",
    "pytest_collect_file",
    "pytest_collection_finish",
    "pytest_collection_modifyitems",
    "pytest_configure",
    "pytest_ignore_collect",
    "pytest_plugins",
    "pytest_pycollect_makemodule",
    "pytest_report_header",
    "pytest_report_teststatus",
    "pytest_runtest_logreport",
    "pytest_runtest_makereport",
    "pytest_sessionfinish",
    "pytest_sessionstart",
    "pytest_terminal_summary",
    "pytest_testnodedown",
    "pytest_unconfigure",
    "pytest_xdist_node_collection_finished",
]

pytest_plugins = [f"{__package__}.fixtures.{protocol}" for protocol in OWN]
"""The fixtures of the kit's own protocols; a package that registers a protocol has a pytest plugin of its own."""

_FACTS = "otmcp_facts"
_RESULT = "otmcp_result"
_NARROWED = "otmcp_narrowed"


# -- options and configuration ------------------------------------------------------------------------------------


def pytest_addoption(parser: pytest.Parser) -> None:
    add_options(parser)


def pytest_configure(config: pytest.Config) -> None:
    config.stash[STARTED] = time.monotonic()
    config.addinivalue_line("markers", "otmcp: a conformance item of pytest-otmcp")
    for suite in SUITES:
        config.addinivalue_line("markers", f"otmcp_{suite}: an item of the {suite} suite")
    for protocol in protocol_keys():
        config.addinivalue_line("markers", f"otmcp_{protocol}: an item on this protocol alone")
    config.addinivalue_line("markers", "otmcp_cross: an item on several protocols")
    if config.option.help or config.option.version:
        # What is wrong with an ini must not keep anybody from reading how to correct it.
        return
    try:
        config.stash[SETTINGS] = read_settings(config)
    except UsageError as error:
        _refuse(error)
    suite_by_default(config)


def _refuse(error: UsageError) -> NoReturn:
    """End the run: one sentence, exit code 2."""
    pytest.exit(str(error), returncode=2)


def _is_worker(config: pytest.Config) -> bool:
    return hasattr(config, "workerinput")


def _worker(config: pytest.Config) -> str | None:
    """The name that pytest-xdist gave this process; None without it."""
    return str(config.workerinput["workerid"]) if hasattr(config, "workerinput") else None


def _load_subject(config: pytest.Config) -> Any:
    from ..subject import load_subject, reference_subject

    source = config.stash[SETTINGS].subject
    try:
        return reference_subject() if source is None else load_subject(source)
    except UsageError as error:
        _refuse(error)


def pytest_sessionstart(session: pytest.Session) -> None:
    config = session.config
    if not _is_worker(config):
        _CONTROLLER["config"] = config
        if config.getoption("dist", "no") != "no" and names_suite(config):
            # Said once and before there are workers, instead of by each of them.
            _load_subject(config)


_CONTROLLER: dict[str, pytest.Config] = {}
"""pytest_runtest_logreport is not told the config; this is the one of the controller of this process."""


def pytest_report_header(config: pytest.Config) -> str | None:
    if config.args == [SUITE] and config.args_source is not pytest.Config.ArgsSource.ARGS:
        return "otmcp: the shipped conformance suite; your own tests run without options of the kit, or when they are named"
    return None


# -- collection ---------------------------------------------------------------------------------------------------


@pytest.hookimpl(tryfirst=True)
def pytest_ignore_collect(collection_path: Path) -> bool | None:
    return False if is_shipped(collection_path) else None


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    return ShippedModule.from_parent(parent, path=module_path) if is_shipped(module_path) else None


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(
    file_path: Path, parent: pytest.Collector
) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    found = yield
    if not found and is_shipped(file_path):
        return [ShippedModule.from_parent(parent, path=file_path)]
    return found


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(
    session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
) -> Generator[None, None, None]:
    tasks = _shipped_tasks(items)
    if not tasks and not names_suite(config):
        return (yield)
    from .interference import Interference

    with quiet():
        shipped = list(_required_tasks(config))
    # Tasks on a protocol that neither the kit nor the subject brings along are no part of this run.
    tasks = {item: task for item, task in tasks.items() if task.id in shipped}
    items[:] = [item for item in items if item in tasks or not is_shipped(item.path) or task_of(item) is None]
    narrowing = config.stash[INTERFERENCE] = Interference(config)
    narrowing.before(items)
    for item, task in tasks.items():
        item.add_marker("otmcp")
        item.add_marker(f"otmcp_{task.suite}")
        item.add_marker(f"otmcp_{task.protocols[0]}" if len(task.protocols) == 1 else "otmcp_cross")
    yield
    settings = config.stash[SETTINGS]
    with quiet():
        narrowing.after(items, shipped, settings)
    left = {item: task for item, task in _shipped_tasks(items).items() if task.suite in settings.suites}
    deselected = [item for item in items if item in tasks and item not in left]
    if deselected:
        config.hook.pytest_deselected(items=deselected)
    # Items run in the suite's order, whoever sorts; other tests stay where they are. An item may be there twice.
    ordered = iter(sorted((item for item in items if item in left), key=lambda item: shipped.index(left[item].id)))
    items[:] = [next(ordered) if item in left else item for item in items if item not in deselected]
    config.stash[PLANNED] = _identifiers(items)


def _required_tasks(config: pytest.Config) -> dict[str, Task]:
    """The tasks that a run with this subject has to have, by id."""
    from ..protocols.registry import protocols
    from ..suite.catalogue import tasks_by_id

    if all(protocol.always for protocol in protocols().values()):
        return tasks_by_id()
    return tasks_by_id(_load_subject(config).adapters)


def _identifiers(items: list[pytest.Item]) -> list[str]:
    return [task.id for item in items if (task := task_of(item)) is not None and is_shipped(item.path)]


def _shipped_tasks(items: list[pytest.Item]) -> dict[pytest.Item, Task]:
    return {item: task for item in items if (task := task_of(item)) is not None and is_shipped(item.path)}


@pytest.hookimpl(trylast=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    config = session.config
    narrowing = config.stash.get(INTERFERENCE, None)
    if narrowing is None or config.option.collectonly:
        return
    from .integrity import changed_files
    from .worker import Run

    tasks = list(_shipped_tasks(session.items).values())
    narrowing.final(config.stash.get(PLANNED, []), _identifiers(session.items))
    with quiet():
        narrowing.note(*changed_files())
        run = config.stash[RUN] = Run(config.stash[SETTINGS], _load_subject(config), tasks, worker=_worker(config))
        if not _is_worker(config):
            _begin_recording(config, run.subject, tasks, workers=0)
    live = config.stash.get(PROGRESS, None)
    if live is not None:
        run.progress = live.repetition


def _begin_recording(config: pytest.Config, subject: Any, tasks: list[Task], *, workers: int) -> None:
    from .controller import RunRecorder
    from .interference import Interference
    from .progress import Progress

    settings = config.stash[SETTINGS]
    narrowing = config.stash.setdefault(INTERFERENCE, Interference(config))
    try:
        config.stash[RECORDER] = RunRecorder(
            settings,
            subject,
            required=list(_required_tasks(config)),
            narrowed=narrowing.sentences,
            workers=workers,
            begun=config.stash[STARTED],
        )
    except UsageError as error:
        _refuse(error)
    config.stash[PROGRESS] = Progress(config, tasks, settings.repetitions)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_node_collection_finished(node: Any, ids: list[str]) -> None:
    """The controller collects nothing itself; it learns of conformance items from its first worker."""
    config = node.config
    if RECORDER in config.stash:
        return
    shipped = [identifier for identifier in ids if names_shipped(config, identifier)]
    if not (shipped or names_suite(config)):
        return
    with quiet():
        known = _required_tasks(config)
        wanted = [known[name] for identifier in shipped if (name := identifier.rpartition("[")[2].rstrip("]")) in known]
        workers = config.getoption("numprocesses") or 1
        _begin_recording(config, _load_subject(config), wanted, workers=workers)


# -- execution ----------------------------------------------------------------------------------------------------


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    result = item.stash.get(RESULT, None)
    if result is not None and report.when == "call":
        # Attributes that are text survive the way from an xdist worker to the controller, whatever an adapter answered.
        setattr(report, _RESULT, json.dumps(result))
        setattr(report, _FACTS, json.dumps(item.config.stash[RUN].facts()))
        del item.stash[RESULT]
    elif report.when == "call" and INTERFERENCE in item.config.stash and is_shipped(item.path):
        item.config.stash[INTERFERENCE].not_executed(item)
    return report


@pytest.hookimpl(trylast=True)
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    content = getattr(report, _RESULT, None)
    config = _CONTROLLER.get("config")
    if content is None or config is None or RECORDER not in config.stash:
        return
    result, facts = json.loads(content), json.loads(getattr(report, _FACTS))
    worker = getattr(getattr(report, "node", None), "gateway", None)
    narrowing = config.stash[INTERFERENCE]
    item = result["item"]
    narrowing.reported(item["id"], item["status"], report.outcome)
    if config.stash[RECORDER].add(result, worker.id if worker is not None else "main", facts):
        config.stash[PROGRESS].finished(item, result["measured"])
    else:
        narrowing.repeated(item["id"])


@pytest.hookimpl(tryfirst=True)
def pytest_report_teststatus(report: pytest.TestReport, config: pytest.Config) -> tuple[str, str, str] | None:
    if getattr(report, _RESULT, None) is not None:
        # The line of the item says it; no letter beside it. Without a word pytest would not count it as progress.
        return report.outcome, "", report.outcome.upper()
    return None


# -- the end ------------------------------------------------------------------------------------------------------


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    config = session.config
    run = config.stash.get(RUN, None)
    recorder = config.stash.get(RECORDER, None)
    narrowing = config.stash.get(INTERFERENCE, None)
    with quiet():
        if run is not None:
            if recorder is not None and run.unfinished is not None:
                recorder.add(run.unfinished, "main", run.facts())
            run.facts()
            run.close()
        if narrowing is None:
            return
        narrowing.finish()
        if recorder is None:
            getattr(config, "workeroutput", {})[_NARROWED] = narrowing.sentences
            return
        limit = config.getoption("maxfail", 0)
        if limit and session.testsfailed >= limit and recorder.missing:
            narrowing.note(f"the run ended at failure number {limit} (-x or --maxfail)")
        recorder.finish(interrupted=exitstatus == pytest.ExitCode.INTERRUPTED)
    session.exitstatus = _exit_status(exitstatus, recorder, session.testsfailed)


def _exit_status(exitstatus: int, recorder: Any, failures: int) -> int:
    """The verdict's exit code, unless pytest has something else to say: interrupted, nothing to run, a broken run, or
    failures beside those that the verdict is about."""
    if exitstatus not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        return exitstatus
    code: int = recorder.exit_code
    if code == 0 and exitstatus != pytest.ExitCode.OK and failures > recorder.failures:
        return exitstatus
    return code


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    said = getattr(node, "workeroutput", {})
    if INTERFERENCE in node.config.stash:
        node.config.stash[INTERFERENCE].note(*said.get(_NARROWED, ()))
    if REFUSED in said:
        _refuse(UsageError(said[REFUSED]))


def pytest_terminal_summary(terminalreporter: Any, exitstatus: int, config: pytest.Config) -> None:
    recorder = config.stash.get(RECORDER, None)
    if recorder is None or (exitstatus == pytest.ExitCode.INTERRUPTED and not recorder.statuses):
        return
    if not recorder.statuses:
        for sentence in config.stash[INTERFERENCE].sentences:
            terminalreporter.write_line(f"narrowed: {sentence}")
        terminalreporter.write_line(f"VERDICT: {recorder.verdict} (no item of the suite ran)", red=True, bold=True)
        return
    from ..report.render import render

    with quiet():
        render(recorder.path, terminalreporter, config.rootpath)


def pytest_unconfigure(config: pytest.Config) -> None:
    if _CONTROLLER.get("config") is config:
        _CONTROLLER.clear()
