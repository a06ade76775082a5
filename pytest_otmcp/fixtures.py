"""Every fixture of the kit: ``otmcp_trial`` for the conformance suite, the others for a vendor's own tests.

Nothing heavy is imported before a test asks for something.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest

from .collection import SUITE, is_shipped, quiet
from .errors import UsageError
from .keys import NARROWING, RESULT, RUN, SETTINGS, WORKSHOP

if TYPE_CHECKING:
    from .devices import Broker, ModbusDevice, OpcUaPlant
    from .fixture_bench import Desk, Workshop
    from .sessions import SessionFactory
    from .subject import Subject
    from .task import Task

__all__ = [
    "REFUSED",
    "otmcp_broker",
    "otmcp_desk",
    "otmcp_modbus_device",
    "otmcp_opcua_plant",
    "otmcp_session",
    "otmcp_subject",
    "otmcp_trial",
]

REFUSED = "otmcp_refused"
"""In what an xdist worker tells the controller at its end: the sentence for which it has ended the run."""


@pytest.fixture
def otmcp_trial(request: pytest.FixtureRequest) -> Callable[[Task], None]:
    """A function that runs a task of the conformance suite and makes the test fail, skip or err as its result says."""

    def run(task: Task) -> None:
        __tracebackhide__ = True
        from .integrity import altered_task, replaced_functions

        config, node = request.config, request.node
        if RUN not in config.stash or not is_shipped(node.path):
            pytest.fail(f"otmcp_trial runs the shipped suite only: pytest --pyargs {SUITE}", pytrace=False)
        with quiet():
            config.stash[NARROWING].note(*altered_task(task))
            try:
                result = config.stash[RUN].execute(task)
            except UsageError as error:
                if hasattr(config, "workeroutput"):
                    config.workeroutput[REFUSED] = str(error)
                pytest.exit(str(error), returncode=2)
            config.stash[NARROWING].note(*replaced_functions())
        node.stash[RESULT] = result
        if result["status"] == "NOT_APPLICABLE":
            pytest.skip(f"{task.id}: {result['reason']}")
        if result["status"] != "PASS":
            pytest.fail(explain(result), pytrace=False)

    return run


def explain(result: dict[str, object]) -> str:
    """The failure message of an item: its first findings, each with the repetition that showed it."""
    samples = result["samples"]
    findings = result["findings"]
    assert isinstance(samples, list)
    assert isinstance(findings, list)
    bad = [sample for sample in samples if not sample["ok"]]
    lines = [
        f"{result['id']} {result['title']} [{result['status']}] {len(samples) - len(bad)}/{result['planned']} passed"
    ]
    lines += [f"  {finding['message']}" for finding in findings]
    for sample in bad[:2]:
        for finding in sample["findings"][:4]:
            rule = f" [{finding['requirement']}]" if finding["requirement"] else ""
            lines.append(f"  rep {sample['repetition'] + 1}/{result['planned']}: {finding['message']}{rule}")
            if finding["evidence"]:
                lines.append(f"      {finding['evidence']}")
    if len(bad) > 2:
        lines.append(f"  … and {len(bad) - 2} more repetitions; all are in run.json")
    return "\n".join(lines)


@pytest.fixture
def otmcp_modbus_device(otmcp_desk: Desk) -> ModbusDevice:
    """A Modbus TCP device that keeps a journal of what reaches it; fresh for every test. See docs/fixtures.md."""
    return otmcp_desk.modbus_device()


@pytest.fixture
def otmcp_broker(otmcp_desk: Desk) -> Broker:
    """An MQTT broker with a Sparkplug B edge node that keeps a journal; fresh for every test. See docs/fixtures.md."""
    return otmcp_desk.broker()


@pytest.fixture
def otmcp_opcua_plant(otmcp_desk: Desk) -> OpcUaPlant:
    """An OPC UA server of a plant that keeps a journal; fresh for every test. See docs/fixtures.md."""
    return otmcp_desk.opcua_plant()


@pytest.fixture
def otmcp_session(otmcp_desk: Desk, otmcp_subject: Subject) -> SessionFactory:
    """``otmcp_session("modbus")`` starts the subject's adapter at the device of the test and opens an MCP session."""
    return otmcp_desk.sessions(otmcp_subject)


@pytest.fixture(scope="session")
def otmcp_subject(request: pytest.FixtureRequest) -> Subject:
    """The subject under test: ``--otmcp-subject``, else ``otmcp.toml``, else the shipped reference adapters."""
    from .subject import load_subject, reference_subject

    source = request.config.stash[SETTINGS].subject
    try:
        return reference_subject() if source is None else load_subject(source)
    except UsageError as error:
        pytest.fail(str(error), pytrace=False)


@pytest.fixture
def otmcp_desk(request: pytest.FixtureRequest) -> Iterator[Desk]:
    """The devices and sessions of one test, from which the fixtures above are made."""
    from .fixture_bench import Desk

    desk = Desk(_workshop(request.config))
    yield desk
    desk.close()


def _workshop(config: pytest.Config) -> Workshop:
    """What this test process has in common, started by the first test that asks for any of it."""
    if WORKSHOP not in config.stash:
        from .fixture_bench import Workshop
        from .station import BenchOptions

        settings = config.stash[SETTINGS]
        workshop = config.stash[WORKSHOP] = Workshop(BenchOptions(era=settings.era, time_scale=settings.time_scale))
        config.add_cleanup(workshop.close)
    return config.stash[WORKSHOP]
