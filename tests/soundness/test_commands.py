"""Adapters with vocabularies of their own: honest ones are accused of nothing, each lie is found by the effect that the file states."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pytest_otmcp.core.matrix import REQUIREMENTS
from pytest_otmcp.subject import Adapter
from pytest_otmcp.suite.catalogue import all_tasks

from .conftest import Judge, failing, foreign_subject, passing, requirements, words

EXPRESSED = "WR-003 WR-004 WR-005 WR-010 WR-014 ERR-006 TMO-004"
"""Rows that need a write, whatever it is, and no read but a status."""

HONEST = {
    "modbus-valves": (f"{EXPRESSED} WR-001 WR-002 WR-009", "M1 S10 R-modbus"),
    "mqtt-lights": (f"{EXPRESSED} MQT-001", "Q1 Q3 S8 S11 R-mqtt"),
}

LIES = {
    ("modbus-valves", "writes-nothing"): ("WR-014", "WR-014"),
    ("modbus-valves", "another-valve"): ("WR-014", "WR-014"),
    ("modbus-valves", "another-value"): ("WR-014", "WR-014"),
    ("modbus-valves", "writes-twice"): ("WR-014", "WR-014"),
    ("modbus-valves", "writes-anyway"): ("WR-004", "WR-004"),
    ("modbus-valves", "sends-again"): ("WR-003", "WR-003 TMO-001"),
    ("modbus-valves", "delivers-later"): ("WR-010", "WR-010"),
    ("modbus-valves", "starts-first"): ("WR-014", "WR-014"),
    ("modbus-valves", "never-starts"): ("WR-014", "WR-014"),
    ("modbus-valves", "starts-again"): ("WR-014", "WR-003 WR-014"),
    ("modbus-valves", "starts-regardless"): ("WR-014", "WR-014"),
    ("modbus-valves", "spares-the-device"): ("WR-014", "WR-014"),
    ("modbus-valves", "guesses-words"): ("WR-014", "WR-014"),
    ("modbus-valves", "says-closed"): ("WR-014", "WR-014"),
    ("modbus-valves", "says-rounded"): ("WR-014", "WR-014"),
    ("modbus-valves", "says-full"): ("WR-014", "WR-014"),
    ("mqtt-lights", "spares-the-device"): ("WR-014", "WR-014"),
    ("mqtt-lights", "guesses-words"): ("WR-014", "WR-014"),
    ("mqtt-lights", "hall-first"): ("WR-014", "WR-014"),
    ("mqtt-lights", "kitchen-alone"): ("WR-014", "WR-014"),
    ("mqtt-lights", "writes-nothing"): ("WR-014", "WR-014"),
    ("mqtt-lights", "another-light"): ("WR-014", "WR-014"),
    ("mqtt-lights", "another-value"): ("WR-014", "WR-014"),
    ("mqtt-lights", "writes-twice"): ("WR-014", "WR-014"),
    ("mqtt-lights", "writes-anyway"): ("WR-004", "WR-004"),
    ("mqtt-lights", "sends-again"): ("WR-003", "WR-003 TMO-001"),
    ("mqtt-lights", "delivers-later"): ("WR-010", "WR-010"),
    ("mqtt-lights", "never-waits"): ("MQT-001", "MQT-001"),
}
"""Each lie with the row that is about it, and the requirements that may be cited."""

QUICK = {"another-value", "starts-first"}


def on(protocol: str, rows: str) -> set[str]:
    return {f"{row}.{protocol}" for row in rows.split()}


def checks_of(protocol: str) -> str:
    every = all_tasks().values()
    return " ".join(task.id for task in every if task.suite == REQUIREMENTS and protocol in task.adapters)


def accused_of_nothing(judge_foreign: Judge, name: str, rows: str, items: str) -> None:
    """Expect that an adapter fails nothing, and passes these rows of the requirement suite, and of the benchmark these items alone."""
    protocol = name.partition("-")[0]
    results = judge_foreign(name, tasks=checks_of(protocol))
    assert failing(results) == set(), words(results)
    assert passing(results) >= on(protocol, rows)
    benchmark = judge_foreign(name)
    assert failing(benchmark) == set(), words(benchmark)
    assert passing(benchmark) == set(items.split())


@pytest.mark.parametrize("name", HONEST)
def test_an_honest_adapter_with_a_vocabulary_of_its_own_passes_what_it_can_express(
    judge_foreign: Judge, name: str
) -> None:
    protocol = name.partition("-")[0]
    results = judge_foreign(name, tasks=" ".join(on(protocol, "WR-004 WR-005 WR-014")))
    assert passing(results) == results.keys(), words(results)


@pytest.mark.long
@pytest.mark.parametrize("name", HONEST)
def test_an_honest_adapter_with_a_vocabulary_of_its_own_is_accused_of_nothing(judge_foreign: Judge, name: str) -> None:
    accused_of_nothing(judge_foreign, name, *HONEST[name])


@pytest.mark.parametrize(
    ("name", "lie"), [pytest.param(*lie, marks=() if lie[1] in QUICK else pytest.mark.long) for lie in LIES]
)
def test_a_lie_about_a_command_is_found(judge_foreign: Judge, name: str, lie: str) -> None:
    row, cited = LIES[name, lie]
    identifier = f"{row}.{name.partition('-')[0]}"
    results = judge_foreign(name, lie=lie, tasks=identifier)
    assert failing(results) == {identifier}, words(results)
    assert requirements(results) <= set(cited.split()), words(results)


STATUS = """messages = "receives nothing" }
bind.info = { tool = "bridge_state", result = { connected = "bridge == 'online'" } }
"""
NO_STATUS = """messages = "receives nothing", info = "has no tool for it" }
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("lie", "status", "said"),
    [
        ("connected", "PASS", ""),
        ("connected-delivers-later", "FAIL", "the broker should have seen no state-changing request"),
        ("connected-writes-nothing", "FAIL", "it claims success"),
    ],
)
def test_an_adapter_without_any_read_is_taken_through_an_outage(
    judge_foreign: Judge, lie: str, status: str, said: str
) -> None:
    results = judge_foreign("mqtt-lights", lie=lie, tasks="WR-010.mqtt", described=(STATUS, NO_STATUS))
    assert results["WR-010.mqtt"]["status"] == status, words(results)
    assert said in words(results)


def test_what_a_command_cannot_express_does_not_apply(judge_foreign: Judge) -> None:
    results = judge_foreign("modbus-valves", tasks="FM2 ADR-003.modbus")
    assert {result["status"] for result in results.values()} == {"NOT_APPLICABLE"}
    assert results["FM2"]["reason"] == (
        "no named command of the subject can express write_holding with address=1, value=70000"
    )


def test_what_a_voluntary_binding_is_not_for_does_not_apply(judge: Judge) -> None:
    def narrowed(adapter: Adapter) -> Adapter:
        bound = adapter.operations["read_typed"]
        assert isinstance(bound, tuple)
        only = tuple(replace(one, when={"type": ["int16", "uint16"]}) for one in bound)
        return replace(adapter, operations={**adapter.operations, "read_typed": only})

    results = judge("modbus", "defective.py", "none", tasks="ENC-005.modbus", described=narrowed)
    assert results["ENC-005.modbus"]["status"] == "NOT_APPLICABLE", words(results)
    assert results["ENC-005.modbus"]["reason"].startswith("no binding of the subject is for read_typed with")


@pytest.mark.parametrize(
    ("name", "described"),
    [
        ("modbus-valves", ('value = "$percent * 10"', 'value = "$percent * 5"')),
        ("modbus-valves", ("address = 40", "address = 41")),
        *(
            pytest.param("mqtt-lights", described, marks=pytest.mark.long)
            for described in (
                ('payload = "RING"', 'payload = "RING", qos = 2'),
                ('payload = "RING"', 'payload = "RING", retain = true'),
                (
                    'home/hall/set", payload = { state = "$state" }',
                    'home/hall/set", payload = { state = "$state" }, qos = 2',
                ),
                ('state = "ON"', 'state = "ON", transition = 1'),
            )
        ),
    ],
)
def test_what_differs_from_the_subject_file_is_a_finding(
    judge_foreign: Judge, name: str, described: tuple[str, str]
) -> None:
    identifier = f"WR-014.{name.partition('-')[0]}"
    assert failing(judge_foreign(name, tasks=identifier, described=described)) == {identifier}


RECIPE = """
[adapter.opcua.commands.apply_recipe]
tool = "write_items"
draws = { position = { lowest = 0, highest = 100, step = 0.5 } }
arguments = { items_to_write = [
    { node = "ns=2;s=ValvePosition", value = "$position" },
    { node = "ns=2;s=PumpEnabled", value = true },
] }
effect = [
    { write = { node = "ns=2;s=ValvePosition", value = "$position" } },
    { write = { node = "ns=2;s=PumpEnabled", value = true } },
]
"""


def test_several_writes_of_one_call_are_told_apart_on_opcua(judge_foreign: Judge) -> None:
    before = "[adapter.opcua.bind.read]"
    honest = judge_foreign("opcua-items", tasks="WR-014.opcua", described=(before, f"{RECIPE}\n{before}"))
    assert passing(honest) == {"WR-014.opcua"}, words(honest)
    first, second = RECIPE.partition("effect = [")[2].split("\n")[1:3]
    swapped = RECIPE.replace(f"{first}\n{second}", f"{second}\n{first}")
    results = judge_foreign("opcua-items", tasks="WR-014.opcua", described=(before, f"{swapped}\n{before}"))
    assert failing(results) == {"WR-014.opcua"}
    assert "each once and in this order, it saw them in another order" in words(results)


EVERYWHERE = foreign_subject("named-everywhere").adapters


@pytest.mark.parametrize(
    "protocol",
    [pytest.param(name, marks=pytest.mark.weekly if number % 3 else ()) for number, name in enumerate(EVERYWHERE)],
)
@pytest.mark.long
def test_named_commands_are_driven_on_every_protocol(judge_foreign: Judge, protocol: str) -> None:
    rows = "WR-003 WR-004 WR-005 WR-010 WR-014"
    results = judge_foreign("named-everywhere", tasks=" ".join(on(protocol, rows)))
    assert passing(results) == on(protocol, rows), words(results)


INAPPLICABLE = {
    # Datagrams have no connection that is refused or reset.
    "ethercat": "ERR-005",
    # Each argument of its command is fixed, or holds two of the values that are drawn.
    "profinet": "ERR-005 ERR-007 MCP-005",
}


@pytest.mark.long
@pytest.mark.parametrize(
    "protocol",
    [
        pytest.param(one, marks=() if one in ("modbus", "mqtt") else pytest.mark.weekly)
        for one in EVERYWHERE
        if one not in ("bacnet", "profibus")
    ],
)
def test_an_adapter_that_reads_by_operations_and_writes_by_commands_is_accused_of_nothing(
    judge_foreign: Judge, protocol: str
) -> None:
    results = judge_foreign("named-everywhere", tasks=checks_of(protocol))
    assert failing(results) == set(), words(results)
    rows = on(protocol, "MCP-004 MCP-005 ERR-001 ERR-005 ERR-007 TMO-003 REC-001 WR-001 WR-002 WR-014")
    assert passing(results) >= rows - on(protocol, INAPPLICABLE.get(protocol, "")), words(results)
