"""What needs no operation is asked of every server, and what needs a read is asked by a call that waits where there is no other one."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace

import pytest

from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record.warnings import warnings as warned
from pytest_otmcp.subject import Adapter

from .conftest import DEFECT, Judge, failing, foreign_subject, passing, requirements, words

WAITING = """
    MCP-001 MCP-002 MCP-003 MCP-005 MCP-006 MCP-007 MCP-008 MCP-009 MCP-010 ERR-001 ERR-005 ERR-007 RD-004 WR-003 WR-010 TMO-001 TMO-002
    TMO-003 TMO-004 REC-001 REC-002 REC-003 REC-005 KEY-001 INJ-001 INJ-002 INJ-003
""".split()
"""Rows that are asked of an MQTT adapter which publishes, and receives by a call that waits alone."""


def on_mqtt(*rows: str) -> str:
    return " ".join(f"{row}.mqtt" for row in rows)


@pytest.mark.long
def test_an_adapter_that_waits_for_messages_and_publishes_passes_what_it_is_asked(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-wait", tasks=on_mqtt(*WAITING))
    assert failing(results) == set(), words(results)
    assert passing(results) == set(on_mqtt(*WAITING).split())


UNASKED = {"MCP-004"}
"""No tool is known then that may be called with an argument too many."""
WITHOUT_OPERATIONS = [f"MCP-{number:03}" for number in (1, 2, 3, 4, 7, 9, 10)]


def bare(adapter: Adapter) -> Adapter:
    """Return an adapter of whose subject file nothing is known but how it is started."""
    return replace(
        adapter,
        operations={},
        unclaimed={name: "unknown" for name in protocols()[adapter.protocol].facets if not name.startswith("recovery")},
    )


def unbound(adapter: Adapter) -> Adapter:
    """Return an adapter that claims every operation, and whose subject file does not say how one is performed."""
    return replace(adapter, operations={})


@pytest.mark.parametrize(
    ("described", "protocol"), [pytest.param(bare, "modbus", marks=pytest.mark.long), (unbound, "mqtt")]
)
def test_a_server_without_any_operation_is_asked_what_needs_none(
    judge: Judge, described: Callable[[Adapter], Adapter], protocol: str
) -> None:
    tasks = " ".join(f"{row}.{protocol}" for row in WITHOUT_OPERATIONS)
    results = judge(protocol, "defective.py", "none", tasks=tasks, described=described)
    assert {name: result["status"] for name, result in results.items()} == {
        f"{row}.{protocol}": "NOT_APPLICABLE" if row in UNASKED else "PASS" for row in WITHOUT_OPERATIONS
    }, words(results)


DEFECTIVE = {
    "MU-49b": ("opcua", "MCP-001 MCP-003", "line(s) on stdout that are no MCP message", False),
    "MU-51b": ("opcua", "MCP-002", "during its handshake", True),
    "MU-52b": ("mqtt", "MCP-009", "the adapter did not exit within", True),
    "MU-52g": ("modbus", "MCP-009", "", True),
}


@pytest.mark.long
@pytest.mark.parametrize("name", DEFECTIVE)
def test_a_defect_of_a_server_without_operations_is_found(judge: Judge, name: str) -> None:
    protocol, rows, said, alone = DEFECTIVE[name]
    tasks = " ".join(f"{row}.{protocol}" for row in {*rows.split(), "MCP-007"})
    results = judge(protocol, *DEFECT, name, tasks=tasks, described=bare)
    wanted = {f"{row}.{protocol}" for row in rows.split()}
    assert failing(results) == (wanted if alone else set(results)), words(results)
    assert said in words(results)


LIES = {
    # It starts when the broker is there, so nothing else of it is amiss.
    "needs-the-broker": ("MCP-002", "MCP-002"),
    "never-refused": ("ERR-001 MCP-010", "MQT-002"),
    "publishes-into-the-void": ("REC-002 WR-010", "MQT-001"),
    "last-words": ("INJ-001", "INJ-001"),
    "raw-text": ("INJ-002", "INJ-002"),
    "by-hand": ("INJ-003", "INJ-003"),
}


@pytest.mark.long
@pytest.mark.parametrize("lie", LIES)
def test_a_lie_of_an_adapter_that_waits_is_found(judge_foreign: Judge, lie: str) -> None:
    rows, cited = LIES[lie]
    results = judge_foreign("mqtt-wait", lie=lie, tasks=on_mqtt(*rows.split(), "MCP-010", "RD-004"))
    assert failing(results) == set(on_mqtt(*rows.split()).split()), words(results)
    assert requirements(results) >= set(cited.split()), words(results)


RESULT = "[{topic: topic, payload: payload}]"


@pytest.mark.long
@pytest.mark.parametrize(
    ("lie", "said"),
    [
        (
            "outage-is-silence",
            "still succeeds and brings nothing, as if the device had nothing to say; nothing was written",
        ),
        ("looks-nowhere", "The answer brings nothing, from wherever; nothing was written"),
    ],
)
def test_an_empty_list_in_an_outage_is_not_told_as_a_value_from_memory(
    judge_foreign: Judge, lie: str, said: str
) -> None:
    described = RESULT, f"{RESULT} | [?topic]"
    results = judge_foreign("mqtt-wait", lie=lie, tasks="WR-010.mqtt", described=described)
    assert failing(results) == {"WR-010.mqtt"}, words(results)
    assert said in words(results)
    assert "from memory" not in words(results)


@pytest.mark.long
def test_a_success_that_says_nothing_is_not_told_as_a_value_from_memory(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-connect", lie="listens-to-nobody", tasks="WR-003.mqtt")
    assert "that was set there did not come back. Another device was asked, or none; nothing was written" in words(
        results
    )


@pytest.mark.long
@pytest.mark.parametrize("lie", ["keeps-its-connection", "tells-the-last-one"])
def test_what_is_told_over_a_connection_whose_end_has_vanished_is_no_success(judge_foreign: Judge, lie: str) -> None:
    described = RESULT, f"{RESULT} | [?topic]"
    results = judge_foreign("mqtt-wait", lie=lie, tasks="REC-003.mqtt REC-005.mqtt", described=described)
    # The next item gets a session of its own.
    assert failing(results) == {"REC-003.mqtt"}, words(results)
    assert "it claims success, and the device answered nothing: its end of the connection has vanished" in words(
        results
    )


def test_writes_without_any_read_are_a_matter_of_the_subject_file(judge_described: Judge) -> None:
    subject = foreign_subject("mqtt-wait")
    adapter = subject.adapters["mqtt"]
    publishes = replace(
        adapter,
        operations={"publish": adapter.operations["publish"]},
        unclaimed={**adapter.unclaimed, "messages": "receives nothing"},
    )
    results = judge_described(replace(subject, adapters={"mqtt": publishes}), "Q3 MCP-001.mqtt MCP-010.mqtt")
    assert {name: result["status"] for name, result in results.items()} == {
        "Q3": "NOT_TESTABLE",
        "MCP-001.mqtt": "PASS",
        "MCP-010.mqtt": "PASS",
    }, words(results)
    assert (
        "the subject file binds none that can be asked for what shows it: bind subscribe or messages or "
        in results["Q3"]["reason"]
    )


@pytest.mark.long
def test_failures_without_words_are_warned_of(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-wait", lie="wordless", tasks=on_mqtt("ERR-007", "MCP-010"))
    assert failing(results) == set(), words(results)
    assert "its text is 'Error executing tool receive_message: '" in words(results)
    assert "ENV-006" in {one["requirement"] for one in warned(results.values())}


def only(*names: str) -> Callable[[Adapter], Adapter]:
    """Return the description of an adapter that has these operations alone."""

    def described(adapter: Adapter) -> Adapter:
        operations = {name: adapter.operations[name] for name in names}
        facets = protocols()[adapter.protocol].facets
        unclaimed = {
            name: "has no tool for it" for name in facets if name.partition(".")[0] not in (*names, "recovery")
        }
        return replace(adapter, operations=operations, unclaimed=unclaimed)

    return described


HOSTILE = ("INJ-001", "INJ-002", "INJ-003")
PARTS = [
    ("opcua", "browse"),
    ("opcua", "read_many"),
    ("bacnet", "list_objects"),
    ("ethernetip", "list_tags"),
    ("modbus", "read_device_information"),
]


BENT_TEXTS = [
    ("MU-54m", "modbus", "read_device_information", "INJ-001"),
    ("MU-108", "opcua", "browse", "INJ-002"),
    ("MU-108e", "ethernetip", "list_tags", "INJ-002"),
]


@pytest.mark.long
@pytest.mark.parametrize(("protocol", "name"), PARTS)
def test_texts_are_looked_for_where_an_adapter_has_only_a_part_of_the_reads(
    judge: Judge, protocol: str, name: str
) -> None:
    rows = [f"{row}.{protocol}" for row in HOSTILE]
    command = (sys.executable, "-P", "-m", "pytest_otmcp.reference_adapters", protocol)
    results = judge(protocol, command=command, tasks=" ".join(rows), described=only(name))
    assert passing(results) == set(rows), words(results)


@pytest.mark.long
@pytest.mark.parametrize(("name", "protocol", "operation", "row"), BENT_TEXTS)
def test_a_text_that_is_bent_by_the_only_read_is_found(
    judge: Judge, name: str, protocol: str, operation: str, row: str
) -> None:
    results = judge(protocol, *DEFECT, name, tasks=f"{row}.{protocol}", described=only(operation))
    assert failing(results) == {f"{row}.{protocol}"}, words(results)


@pytest.mark.parametrize("row", ["ENC-003", "ENC-004", "ENC-005"])
def test_numbers_that_no_operation_reads_are_not_asked_for(judge: Judge, row: str) -> None:
    command = (sys.executable, "-P", "-m", "pytest_otmcp.reference_adapters", "profibus")
    results = judge("profibus", command=command, tasks=f"{row}.profibus", described=only("read_inputs"))
    (result,) = results.values()
    assert (result["status"], result["reason"]) == (
        "NOT_APPLICABLE",
        "the adapter has no operation that reads such a number",
    )
