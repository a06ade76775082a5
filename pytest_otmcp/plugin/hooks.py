"""The hooks of the plugin: options, markers, order of items, progress, record, summary, exit code, pytest-xdist.

In a run without conformance items the plugin does nothing and imports nothing heavy.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from ..core.errors import UsageError
from ..core.exhaustion import exhausted
from ..core.matrix import KNOWN_SUITES, REQUIREMENTS
from ..core.text import MARK, marked, one_line
from ..core.verdict import ExitCode
from ..protocols.own import OWN
from ..protocols.registry import protocol_keys
from .collection import (
    SUITE,
    ShippedModule,
    asks_for_suite,
    default_to_suite,
    ignore_warnings,
    is_needed,
    is_shipped,
    is_shipped_id,
    names_unasked_requirements,
    task_of,
)
from .fixtures.definitions import (
    REFUSED,
    _otmcp_trial,
    otmcp_device,
    otmcp_resources,
    otmcp_session,
    otmcp_subject,
)
from .junit import JUnitFile, tell_junit
from .options import add_options, read_settings
from .parallel import UNFINISHED, ended, untaken
from .selected import known_rows, refuse, required_tasks, select_adapters
from .stash import (
    BASELINE,
    ENDINGS,
    INTERFERENCE,
    PLANNED,
    PROGRESS,
    RECORDER,
    RESULT,
    RUN,
    SETTINGS,
    STARTED,
    SURROUNDINGS,
)

if TYPE_CHECKING:
    from ..report.baseline import Baseline
    from ..subject.selection import Selection
    from ..trial.task import Task
    from .controller import RunRecorder
    from .endings import Endings
    from .worker import Run

__all__ = [
    "_otmcp_trial",
    "otmcp_device",
    "otmcp_resources",
    "otmcp_session",
    "otmcp_subject",
    "pytest_addoption",
    "pytest_collect_file",
    "pytest_collection",
    "pytest_collection_finish",
    "pytest_collection_modifyitems",
    "pytest_configure",
    "pytest_ignore_collect",
    "pytest_plugins",
    "pytest_pycollect_makemodule",
    "pytest_report_header",
    "pytest_report_teststatus",
    "pytest_runtest_makereport",
    "pytest_sessionfinish",
    "pytest_sessionstart",
    "pytest_terminal_summary",
    "pytest_testnodedown",
    "pytest_testnodeready",
    "pytest_xdist_make_scheduler",
    "pytest_xdist_node_collection_finished",
]

pytest_plugins = [f"{__package__}.fixtures.{protocol}" for protocol in OWN]
"""Modules with the fixtures of the kit's own protocols; a package that registers a protocol has its own pytest plugin."""

_FACTS = "otmcp_facts"
_RESULT = "otmcp_result"
_NARROWED = "otmcp_narrowed"


# -- options and configuration ------------------------------------------------------------------------------------


def pytest_addoption(parser: pytest.Parser) -> None:
    add_options(parser)


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    config.stash[STARTED] = time.monotonic()
    config.addinivalue_line("markers", "otmcp: a conformance item of pytest-otmcp")
    for suite in KNOWN_SUITES:
        config.addinivalue_line("markers", f"otmcp_{suite}: an item of the {suite} suite")
    for protocol in protocol_keys():
        config.addinivalue_line("markers", f"otmcp_{protocol}: an item on this protocol alone")
    config.addinivalue_line("markers", "otmcp_cross: an item on several protocols")
    if config.option.help or config.option.version:
        # A mistake in the ini must not prevent the user from reading how to correct it.
        return
    try:
        settings = read_settings(config)
        config.stash[SETTINGS] = replace(settings, only=known_rows(settings.only))
        config.stash[BASELINE] = None if _is_worker(config) else _read_baseline(settings.baseline)
    except UsageError as error:
        refuse(error)
    if config.stash[SETTINGS].devices and (_is_worker(config) or config.getoption("dist", "no") != "no"):
        refuse(
            UsageError(
                "--otmcp-device: a real device is used by one process at a time; leave out what starts pytest-xdist (-n, --dist)"
            )
        )
    default_to_suite(config)
    if asks_for_suite(config):
        config.pluginmanager.register(JUnitFile(config))
        # The suite has no asynchronous fixtures; without an ini of the user's, this would be the first thing that a run shows.
        warnings.filterwarnings("ignore", 'The configuration option "asyncio_default_fixture_loop_scope" is unset')
        if getattr(config.option, "maxschedchunk", 1) is None:
            # pytest-xdist hands out a quarter of a worker's share at once; the longest items would be one worker's.
            config.option.maxschedchunk = 1
    if (named := names_unasked_requirements(config, config.stash[SETTINGS].suites)) is not None:
        refuse(UsageError(f"{named}: the requirement suite runs when it is asked for: --otmcp-suite={REQUIREMENTS}"))


def _is_worker(config: pytest.Config) -> bool:
    return hasattr(config, "workerinput")


def _worker(config: pytest.Config) -> str | None:
    """Return the name that pytest-xdist gave this process; None without pytest-xdist."""
    return str(config.workerinput["workerid"]) if hasattr(config, "workerinput") else None


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> Generator[None]:
    config = session.config
    if not _is_worker(config):
        config.pluginmanager.register(_ResultReceiver(config))
    if not asks_for_suite(config) or config.option.collectonly:
        return (yield)
    _endings(config).install()
    if not _is_worker(config) and config.getoption("dist", "no") != "no":
        # An error in the subject file is reported once here, instead of by each of the workers that start later.
        select_adapters(config)
    try:
        return (yield)
    except KeyboardInterrupt:
        # pytest has no summary of a session that did not start, and pytest-xdist takes its time to start one.
        _end_unstarted(config)
        raise


def _end_unstarted(config: pytest.Config) -> None:
    """Print the verdict of a run that was interrupted before its items were known, and remove what an earlier run has left: somebody
    might take it for this one's."""
    from .controller import clear_unowned

    clear_unowned(config.stash[SETTINGS].report_dir)
    terminal = config.pluginmanager.get_plugin("terminalreporter")
    if terminal is not None:
        terminal.write_line("VERDICT: INCOMPLETE (interrupted before the items were collected)", red=True, bold=True)


def pytest_report_header(config: pytest.Config) -> str | None:
    if config.args == [SUITE] and config.args_source is not pytest.Config.ArgsSource.ARGS:
        return "otmcp: the shipped conformance suite; your own tests run without options of the kit, or when they are named"
    return None


# -- collection ---------------------------------------------------------------------------------------------------


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    if not _is_worker(session.config) and asks_for_suite(session.config):
        # What ends the run while a module is collected is shown with a traceback, for each of the modules.
        with ignore_warnings():
            select_adapters(session.config)


@pytest.hookimpl(tryfirst=True)
def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    if not is_shipped(collection_path):
        return None
    return not is_needed(collection_path, config.stash[SETTINGS].suites)


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    return _shipped_module(parent, module_path) if is_shipped(module_path) else None


def _shipped_module(parent: pytest.Collector, path: Path) -> ShippedModule:
    return ShippedModule.from_parent(parent, path=path, required=partial(required_tasks, parent.config))


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(
    file_path: Path, parent: pytest.Collector
) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    found = yield
    if not found and is_shipped(file_path):
        return [_shipped_module(parent, file_path)]
    return found


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(
    session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
) -> Generator[None, None, None]:
    if not _shipped_tasks(items) and not asks_for_suite(config):
        return (yield)
    from .interference import Interference

    with ignore_warnings():
        required = list(required_tasks(config))
    tasks = _drop_unrequired_items(items, required)
    interference = config.stash[INTERFERENCE] = Interference(config)
    interference.note_collected(items)
    _mark_items(tasks)
    yield
    settings = config.stash[SETTINGS]
    with ignore_warnings():
        interference.check_selection(items, required, settings)
    selected = {item: task for item, task in _shipped_tasks(items).items() if settings.wants(task)}
    _deselect(config, items, [item for item in items if item in tasks and item not in selected])
    # The items of the last suites take longest: a worker that began one of them at the end would keep the others waiting.
    _sort(items, selected, required[::-1] if _is_worker(config) else required)
    config.stash[PLANNED] = _task_ids(items)


def _drop_unrequired_items(items: list[pytest.Item], required: list[str]) -> dict[pytest.Item, Task]:
    """Remove items on a protocol that neither the kit nor the subject brings along; return the tasks of the others."""
    tasks = {item: task for item, task in _shipped_tasks(items).items() if task.id in required}
    items[:] = [item for item in items if item in tasks or not is_shipped(item.path) or task_of(item) is None]
    return tasks


def _mark_items(tasks: dict[pytest.Item, Task]) -> None:
    """Add the markers by which ``-m`` selects items."""
    for item, task in tasks.items():
        item.add_marker("otmcp")
        item.add_marker(f"otmcp_{task.suite}")
        item.add_marker(f"otmcp_{task.protocols[0]}" if len(task.protocols) == 1 else "otmcp_cross")


def _deselect(config: pytest.Config, items: list[pytest.Item], deselected: list[pytest.Item]) -> None:
    """Remove items of suites that the user did not ask for, and report them to pytest."""
    if deselected:
        config.hook.pytest_deselected(items=deselected)
    items[:] = [item for item in items if item not in deselected]


def _sort(items: list[pytest.Item], tasks: dict[pytest.Item, Task], order: list[str]) -> None:
    """Sort the items that have a task as their ids are in ``order``, also where a plugin has sorted them before; other tests
    stay where they are. An item may be in the list twice."""
    ordered = iter(sorted((item for item in items if item in tasks), key=lambda item: order.index(tasks[item].id)))
    items[:] = [next(ordered) if item in tasks else item for item in items]


def _task_ids(items: list[pytest.Item]) -> list[str]:
    """Return the ids of the tasks of all items of the suite; a task with two items is listed twice."""
    return [task.id for item in items if (task := task_of(item)) is not None and is_shipped(item.path)]


def _shipped_tasks(items: list[pytest.Item]) -> dict[pytest.Item, Task]:
    """Return the items of the suite, each with its task."""
    return {item: task for item in items if (task := task_of(item)) is not None and is_shipped(item.path)}


@pytest.hookimpl(trylast=True)
def pytest_collection_finish(session: pytest.Session) -> None:
    config = session.config
    interference = config.stash.get(INTERFERENCE, None)
    if interference is None or config.option.collectonly:
        return
    from .integrity import changed_files
    from .worker import Run

    _endings(config).install()

    tasks = list(_shipped_tasks(session.items).values())
    interference.check_execution_plan(config.stash.get(PLANNED, []), _task_ids(session.items))
    with ignore_warnings():
        interference.note(*changed_files())
        selection = select_adapters(config)
        run = config.stash[RUN] = Run(config.stash[SETTINGS], selection.subject, tasks, worker=_worker(config))
        if not _is_worker(config):
            _begin_recording(config, selection, tasks, workers=0)
    progress = config.stash.get(PROGRESS, None)
    if progress is not None:
        run.progress, run.starting, run.waiting = progress.show_repetition, progress.show_start, progress.show_waiting


def _begin_recording(config: pytest.Config, selection: Selection, tasks: list[Task], *, workers: int) -> None:
    """Create the recorder and the progress of this run; only the controller has them."""
    from ..session.keeper import hide_memory
    from ..subject.tested import programs
    from ..suite.catalogue import kit_digest
    from ..trial.applicability import applicability
    from .controller import RunRecorder
    from .interference import Interference
    from .progress import Progress
    from .surroundings import Surroundings, unknown_startup_files

    # With pytest-xdist this process executes no items, but it decides the verdict.
    hide_memory()
    _endings(config).install()
    settings = config.stash[SETTINGS]
    interference = config.stash.setdefault(INTERFERENCE, Interference(config))
    try:
        config.stash[RECORDER] = RunRecorder(
            settings,
            selection,
            required=list(required_tasks(config)),
            narrowed=interference.sentences,
            workers=workers,
            begun=config.stash[STARTED],
        )
    except UsageError as error:
        refuse(error)
    with ignore_warnings():
        interference.note(*unknown_startup_files())
        config.stash[SURROUNDINGS] = Surroundings(
            (*selection.subject.sources(), *programs(selection.subject)),
            (config.rootpath, config.invocation_params.dir),
            kit_digest.__wrapped__,
        )
    config.add_cleanup(config.stash[RECORDER].close)
    adapters = selection.subject.adapters
    config.stash[PROGRESS] = Progress(
        config,
        tasks,
        settings.repetitions,
        inapplicable=[task.id for task in tasks if applicability(task, adapters) is not None],
        workers=workers,
    )


def _endings(config: pytest.Config) -> Endings:
    """Return the signals that end the run; they are handled as before when the run is over."""
    from .endings import Endings

    if ENDINGS not in config.stash:
        config.stash[ENDINGS] = Endings()
        config.add_cleanup(config.stash[ENDINGS].restore)
    return config.stash[ENDINGS]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodeready(node: Any) -> None:
    """Note the process of a worker; one on another machine has none here."""
    process = getattr(getattr(node.gateway, "_io", None), "popen", None)
    if process is not None:
        _endings(node.config).workers[process.pid] = node


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    # All adapters of a subject file are started before the first item, by each worker: see Run.
    if config.getoption("dist") != "load" or not asks_for_suite(config) or config.stash[SETTINGS].subject is not None:
        return None
    from .distribution import Distribution

    with ignore_warnings():
        return Distribution(config, log, {name: task.adapters for name, task in required_tasks(config).items()})


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_node_collection_finished(node: Any, ids: list[str]) -> None:
    """Begin the record on the controller, which collects no items itself and learns of them from its first worker."""
    config = node.config
    if RECORDER in config.stash:
        return
    shipped = [identifier for identifier in ids if is_shipped_id(config, identifier)]
    if not (shipped or asks_for_suite(config)):
        return
    with ignore_warnings():
        known = required_tasks(config)
        planned = [
            known[name] for identifier in shipped if (name := identifier.rpartition("[")[2].rstrip("]")) in known
        ]
        workers = config.getoption("numprocesses") or 1
        _begin_recording(config, select_adapters(config), planned, workers=workers)


# -- execution ----------------------------------------------------------------------------------------------------


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    result = item.stash.get(RESULT, None)
    if result is not None and report.when == "call":
        # An attribute that is text reaches the controller from an xdist worker unchanged, whatever an adapter has answered.
        setattr(report, _RESULT, json.dumps(result))
        setattr(report, _FACTS, json.dumps(item.config.stash[RUN].facts()))
        del item.stash[RESULT]
        # What libraries have logged meanwhile may repeat an adapter's words.
        report.sections = [(title, marked(f"{MARK}{content}", "")) for title, content in report.sections]
    elif report.when == "call" and INTERFERENCE in item.config.stash and is_shipped(item.path):
        item.config.stash[INTERFERENCE].add_unexecuted(item)
    return report


@contextmanager
def _writable(recorder: RunRecorder) -> Iterator[None]:
    """End the run with one sentence when its record cannot be written: without a record there is nothing to judge."""
    try:
        yield
    except OSError as error:
        if (cure := exhausted(error)) is None:
            cure = f"{error.strerror or error}; an adapter can do that to the files of a report directory"
        pytest.exit(f"{recorder.path} cannot be written: {cure}", returncode=ExitCode.INDETERMINATE)


class _ResultReceiver:
    """Plugin of the controller that takes the results from the reports of items, and keeps pytest from telling them twice.

    It is an object with the config, because pytest does not hand the config to ``pytest_runtest_logreport``.
    """

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Write the name of a suite where pytest would write the path of its file."""
        config = self._config
        terminal: Any = config.pluginmanager.get_plugin("terminalreporter")
        if terminal is not None and PROGRESS in config.stash:
            suite = Path(nodeid.partition("::")[0]).stem.removeprefix("test_")
            headed = is_shipped_id(config, nodeid) and config.stash[PROGRESS].show_suite(suite)
            # None is pytest's own choice.
            terminal.showfspath = False if headed else None

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        content = getattr(report, _RESULT, None)
        config = self._config
        if content is None or RECORDER not in config.stash:
            return
        result, facts = json.loads(content), json.loads(getattr(report, _FACTS))
        worker = getattr(getattr(report, "node", None), "gateway", None)
        interference = config.stash[INTERFERENCE]
        item = result["item"]
        interference.check_outcome(item["id"], item["status"], report.outcome)
        with config.stash[ENDINGS].held(), _writable(config.stash[RECORDER]):
            is_new = config.stash[RECORDER].add(result, worker.id if worker is not None else "main", facts)
        if is_new:
            config.stash[PROGRESS].show_finished(item, result["measured"])
        else:
            interference.add_repeated(item["id"])

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_terminal_summary(self, terminalreporter: Any) -> Generator[None]:
        """Leave the kit's items out of pytest's lists of failures, unless it is asked for more: the causes say the same in short, and the
        verdict stays in sight."""
        stats = terminalreporter.stats
        failed = stats.get("failed", [])
        if not failed or self._config.option.verbose > 0 or RECORDER not in self._config.stash:
            return (yield)
        stats["failed"] = [report for report in failed if getattr(report, _RESULT, None) is None]
        try:
            return (yield)
        finally:
            # pytest counts them in its last line.
            stats["failed"] = failed


@pytest.hookimpl(tryfirst=True)
def pytest_report_teststatus(report: pytest.TestReport, config: pytest.Config) -> tuple[str, str, str] | None:
    content = getattr(report, _RESULT, None)
    if content is None or config.option.verbose < 0:
        return None
    if config.option.verbose > 0:
        from .progress import verbose_word

        return report.outcome, "", verbose_word(json.loads(content))
    # Progress writes a row for the item, so pytest writes no letter; without the word it would not count the item.
    return report.outcome, "", report.outcome.upper()


# -- the end ------------------------------------------------------------------------------------------------------


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    config = session.config
    endings = config.stash.get(ENDINGS, None)
    if endings is not None:
        endings.finishing()
    run = config.stash.get(RUN, None)
    recorder = config.stash.get(RECORDER, None)
    interference = config.stash.get(INTERFERENCE, None)
    unrestored = None
    with ignore_warnings():
        if run is not None:
            if recorder is not None and run.unfinished is not None:
                with _writable(recorder):
                    recorder.add(run.unfinished, "main", run.facts())
            facts = run.facts()
            if recorder is None and run.unfinished is not None and hasattr(config, "workeroutput"):
                config.workeroutput[UNFINISHED] = json.dumps([run.unfinished, facts])
            unrestored = _close(run)
            if unrestored is not None and interference is not None:
                interference.note(unrestored)
        if interference is None:
            return
        interference.finish()
        if recorder is None:
            getattr(config, "workeroutput", {})[_NARROWED] = interference.sentences
            return
        limit = config.getoption("maxfail", 0)
        if limit and session.testsfailed >= limit and recorder.missing:
            interference.note(f"the run ended at failure number {limit} (-x or --maxfail)")
            if exitstatus == pytest.ExitCode.INTERRUPTED and (endings is None or endings.name is None):
                # So pytest-xdist ends such a run, which nobody has interrupted.
                exitstatus = pytest.ExitCode.TESTS_FAILED
        if endings is not None and endings.name is not None:
            _take_from_workers(config, recorder, list(endings.workers.values()))
        # Whoever interrupts early is gone before there are any.
        if SURROUNDINGS in config.stash:
            interference.note(*config.stash[SURROUNDINGS].changes())
        with _writable(recorder):
            recorder.finish(interrupted=_interruption(exitstatus, endings))
    session.exitstatus = (
        _exit_status(exitstatus, recorder, session.testsfailed) if unrestored is None else ExitCode.INDETERMINATE
    )
    with ignore_warnings():
        tell_junit(config, recorder)


def _close(run: Run) -> str | None:
    """End a run's sessions and devices; return what a real device did not get back, a sentence, or None."""
    from ..core.errors import KitError

    try:
        run.close()
    except KitError as error:
        return str(error)
    return None


def _take_from_workers(config: pytest.Config, recorder: RunRecorder, nodes: list[Any]) -> None:
    """Take what the workers have measured, and pytest-xdist does not hand on any more."""
    ended(nodes)
    for report in untaken(config):
        config.hook.pytest_runtest_logreport(report=report)
    for node in nodes:
        content = getattr(node, "workeroutput", {}).get(UNFINISHED)
        if content is not None:
            result, facts = json.loads(content)
            with _writable(recorder):
                recorder.add(result, node.gateway.id, facts)


def _interruption(exitstatus: int, endings: Endings | None) -> str | None:
    """Say what interrupted the run; None for a run that was not interrupted."""
    if exitstatus != pytest.ExitCode.INTERRUPTED:
        return None
    name = None if endings is None else endings.name
    return "interrupted by the user" if name in (None, "SIGINT") else f"ended by {name}"


def _exit_status(exitstatus: int, recorder: Any, failures: int) -> int:
    """Return the verdict's exit code, or pytest's own for an interrupted or broken run, a run without tests, or a run with
    failures beside those that the verdict is about."""
    if exitstatus not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        return exitstatus
    code: int = recorder.exit_code
    if code == 0 and exitstatus != pytest.ExitCode.OK and failures > recorder.failures:
        return exitstatus
    return code


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    output = getattr(node, "workeroutput", {})
    if INTERFERENCE in node.config.stash:
        node.config.stash[INTERFERENCE].note(*output.get(_NARROWED, ()))
    if REFUSED in output:
        sentence, code = output[REFUSED]
        pytest.exit(one_line(sentence), returncode=code)


def _read_baseline(path: Path | None) -> Baseline | None:
    """Read the record to compare with; this run may write its own to the same place.

    Raises:
        UsageError: it is no record that can be believed.
    """
    if path is None:
        return None
    from ..record.reader import RecordError
    from ..report.baseline import read_baseline

    try:
        return read_baseline(path)
    except RecordError as error:
        raise UsageError(f"--otmcp-baseline: {error}") from None


def pytest_terminal_summary(terminalreporter: Any, exitstatus: int, config: pytest.Config) -> None:
    recorder = config.stash.get(RECORDER, None)
    # A run that was refused has the same exit code as one that was interrupted.
    interrupted = ENDINGS in config.stash and config.stash[ENDINGS].name is not None
    refused = exitstatus == pytest.ExitCode.INTERRUPTED and not interrupted
    if recorder is None:
        if interrupted and asks_for_suite(config):
            _end_unstarted(config)
        return
    if refused and not recorder.statuses:
        return
    if not recorder.statuses:
        for sentence in config.stash[INTERFERENCE].sentences:
            terminalreporter.write_line(one_line(f"narrowed: {sentence}"))
        for sentence in recorder.not_measured.values():
            terminalreporter.write_line(one_line(f"note: {sentence}"))
        reason = "interrupted before the first item" if interrupted else "no item of the suite ran"
        terminalreporter.write_line(f"VERDICT: {recorder.verdict} ({reason})", red=True, bold=True)
        return
    from ..report.render import render

    with ignore_warnings():
        render(recorder.path, terminalreporter, config.rootpath, config.stash[BASELINE])
