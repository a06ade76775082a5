"""Adapters without the kit's envelope and names: honest ones pass what they claim, each lie fails exactly its tasks."""

from __future__ import annotations

import pytest

from .conftest import IMPATIENT, Judge, failing, lane, passing, requirements, words

NO_MQTT = "the subject has no adapter for MQTT"
NO_OPCUA = "the subject has no adapter for OPC UA"
NO_MODBUS = "the subject has no adapter for Modbus"

MODBUS_ALONE = {"X1": NO_OPCUA, "X2": NO_OPCUA, "X1p": NO_OPCUA, "X2p": NO_OPCUA, "FX1": NO_OPCUA}
MODBUS_WITHOUT_PING = {"M1": "modbus.ping is not claimed: has no tool for it", **MODBUS_ALONE}
OTHERS_ALONE = dict.fromkeys(MODBUS_ALONE, NO_MODBUS)
NO_SPARKPLUG = {"Q4": "mqtt.device_birth is not claimed: does not speak Sparkplug"}

HONEST = {
    "modbus-prose": ("M2 M3 M4 FM1 FM2 S1 S4 S7 S10 R-modbus", MODBUS_WITHOUT_PING),
    "modbus-json": ("M1 M2 M3 M4 FM1 FM2 S1 S4 S7 S10 R-modbus", MODBUS_ALONE),
    "modbus-http": ("M2 M3 M4 FM1 FM2 S1 S4 S7 S10 R-modbus", MODBUS_WITHOUT_PING),
    "mqtt-connect": (
        "Q1 Q2 Q3 FQ1 S2 S5 S8 S11 R-mqtt",
        {"FQ2": "mqtt.subscribe.qos is not claimed: the tool takes no QoS", **NO_SPARKPLUG, **OTHERS_ALONE},
    ),
    "mqtt-handle": ("Q1 Q2 Q3 FQ1 FQ2 S2 S5 S8 S11 R-mqtt", {**NO_SPARKPLUG, **OTHERS_ALONE}),
    "mqtt-session": (
        "Q1 Q2 Q3 FQ1 FQ2 S2 S5 S8 S11 R-mqtt",
        {"Q4": "mqtt.device_birth is not claimed: does not speak Sparkplug B", **OTHERS_ALONE},
    ),
    "mqtt-payloads": (
        "Q1 Q2 S2 S8 S11 R-mqtt",
        {
            **dict.fromkeys(("Q3", "S5", "FQ1"), "mqtt.publish is not claimed: only receives"),
            "Q4": "mqtt.device_birth is not claimed: does not speak Sparkplug B",
            "FQ2": "mqtt.subscribe.qos is not claimed: the tool takes no QoS",
            **OTHERS_ALONE,
        },
    ),
    "mqtt-collect": (
        "Q2 S2 S11 R-mqtt",
        {
            **dict.fromkeys(("Q1", "S5", "S8"), "mqtt.info is not claimed: has no tool for it"),
            **dict.fromkeys(("Q3", "FQ1"), "mqtt.publish is not claimed: has no writes"),
            "Q4": "mqtt.device_birth is not claimed: has no writes",
            "FQ2": "mqtt.subscribe is not claimed: receives by a call that waits",
            **OTHERS_ALONE,
        },
    ),
    "opcua-items": (
        "O1 O2 O3 O4 FO1 FO2 S3 S6 S9 R-opcua",
        {"S12": "opcua.recovery is not claimed: needs a new session after an outage", **OTHERS_ALONE},
    ),
}


QUICK = {
    "modbus-json": [],
    "modbus-prose": [],
    "modbus-http": [],
    "mqtt-connect": ["publishes-into-the-void"],
    "mqtt-handle": ["farewell-for-hello"],
    "mqtt-session": [],
    "mqtt-payloads": [],
    "mqtt-collect": [],
    "opcua-items": [],
}
"""Lies that are told in every test run, by adapter; the others are told in the long tests."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(one, marks=() if one in ("modbus-json", "mqtt-handle") else pytest.mark.long) for one in HONEST],
)
def test_an_honest_adapter_passes_what_it_claims(judge_foreign: Judge, name: str) -> None:
    tasks, reasons = HONEST[name]
    results = judge_foreign(name)
    assert failing(results) == set(), words(results)
    assert passing(results) == set(tasks.split())
    assert {
        identifier: result["reason"] for identifier, result in results.items() if result["status"] == "NOT_APPLICABLE"
    } == reasons


@pytest.mark.long
def test_an_adapter_that_waits_for_one_message_after_the_other_is_honest(judge_foreign: Judge) -> None:
    # What is bent is no lie: it is told like one.
    results = judge_foreign("mqtt-collect", lie="one-at-a-time", tasks="Q2 S2")
    assert passing(results) == {"Q2", "S2"}, words(results)


TOPICS = 'result.messages = "[{topic: topic, payload: payload}]"'
ALONE = 'topic = "subscribed"\nresult.messages = "[payload]"'


def test_an_adapter_that_waits_for_payloads_without_topics_is_judged_by_them(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-wait", tasks="Q2 S2", described=(TOPICS, ALONE))
    assert passing(results) == {"Q2", "S2"}, words(results)


def test_what_is_about_the_topics_that_a_wildcard_selects_does_not_apply_without_topics(judge_foreign: Judge) -> None:
    results = judge_foreign("mqtt-payloads", tasks="MQT-002.mqtt MQT-004.mqtt INJ-003.mqtt")
    assert {name: result["status"] for name, result in results.items()} == {
        "MQT-002.mqtt": "PASS",
        "MQT-004.mqtt": "NOT_APPLICABLE",
        "INJ-003.mqtt": "PASS",
    }, words(results)
    assert results["MQT-004.mqtt"]["reason"] == (
        "the messages that the subject returns have no topics: what a wildcard brought cannot be told apart"
    )


READY = 'ready = { tool = "connection_status", text = "^state: connected$" }'
STARTS = "start_timeout_s = 1.0"


@pytest.mark.long
def test_an_adapter_that_connects_in_the_background_is_waited_for(judge_foreign: Judge) -> None:
    tasks, _ = HONEST["modbus-prose"]
    claims = "unclaimed = { ping"
    results = judge_foreign("modbus-prose", lie="in-the-background", described=(claims, f"{READY}\n{claims}"))
    assert failing(results) == set(), words(results)
    assert passing(results) == set(tasks.split())


def test_a_connect_step_need_not_succeed_while_the_device_is_away(judge_foreign: Judge) -> None:
    described = ('answer = "text"', 'connect = { tool = "connect" }\nanswer = "text"')
    results = judge_foreign("modbus-prose", lie="connects-by-a-step", described=described, tasks="M2 MCP-002.modbus")
    assert passing(results) == results.keys(), words(results)


def test_an_adapter_that_is_never_ready_is_told_so(judge_foreign: Judge) -> None:
    claims = "unclaimed = { ping"
    described = claims, f"{READY}\n{STARTS}\n{claims}"
    results = judge_foreign("modbus-prose", lie="never-ready", described=described, tasks="M2 M3")
    assert failing(results) == {"M2", "M3"}
    said = (
        "'connection_status' did not say within 1 s of the start that the adapter is ready; it said: state: connecting"
    )
    assert said in words(results)


def test_adapters_of_three_shapes_work_together(judge_foreign: Judge) -> None:
    results = judge_foreign("modbus-prose", "mqtt-connect", "opcua-items", tasks="X1 X2 X1p X2p FX1")
    assert passing(results) == {"X1", "X2", "X1p", "X2p", "FX1"}, words(results)


LIES = {
    ("modbus-prose", "demo-mode"): (
        "M2 M3 M4 FM1 FM2 S1 S4 S7 S10 R-modbus",
        "claims success, but says itself that it is not the device's: Demo Mode",
    ),
    ("modbus-prose", "wrong-table"): ("M2 S1 S7 S10", "should have been asked for 4 cell(s) from 0 by function 4"),
    ("modbus-prose", "partial-write"): ("FM2", "the device should have seen no state-changing request, it saw 1"),
    ("modbus-prose", "guard-in-words"): ("M4", "the device should have seen no state-changing request, it saw 1"),
    ("modbus-prose", "guard-by-hiding"): ("M4", "expected an error envelope with code writes_disabled, it claims"),
    ("modbus-json", "not-a-number"): ("M2 S1 S7", "the reply says null"),
    ("modbus-json", "cache"): ("FM1 S10 R-modbus", "says itself that it is not the device's: source is 'cache'"),
    ("modbus-json", "silent-cache"): ("M2 FM1 S7 S10 R-modbus", "values should be"),
    ("modbus-json", "dry-run"): ("M3 M4 FM2 S4 S10", "not the device's: dry_run is True"),
    ("modbus-json", "clamps-value"): ("FM2", "asked to write 70000; the adapter said"),
    ("modbus-json", "applied-late"): ("FM2", "should have seen one write of [65535] to holding_registers 1, it saw 3"),
    ("modbus-json", "makes-up-late"): ("R-modbus", "the device should have seen no state-changing request, it saw 1"),
    ("modbus-json", "applied-later"): ("M4", "the device should have seen no state-changing request, it saw"),
    ("modbus-json", "makes-up-for-it"): ("S10", "the device should have seen no state-changing request, it saw 1"),
    ("modbus-http", "reads-neighbour"): (
        "M2 M3 FM1 S1 S4 S7 S10",
        "should have been asked for 4 cell(s) from 0 by function 4",
    ),
    ("mqtt-connect", "always-connected"): ("Q1 S8 S11 R-mqtt", "the broker should have answered at least"),
    ("mqtt-connect", "publishes-into-the-void"): ("S11", "it claims success"),
    ("mqtt-connect", "no-wildcards"): ("Q2 S2", "the broker should have granted 'sensors/#', it saw SUBSCRIBE for"),
    ("mqtt-connect", "acknowledges-nonsense"): ("FQ1", "it claims success"),
    ("mqtt-connect", "false-failure"): ("Q3 FQ1 S5", "timeout or error while publishing"),
    ("mqtt-handle", "clamps-qos"): ("FQ2", "it claims success"),
    ("mqtt-handle", "applied-nevertheless"): (
        "FQ2",
        "the broker should have seen no SUBSCRIBE from the adapter, it saw",
    ),
    ("mqtt-handle", "farewell-for-hello"): ("Q1 Q3 R-mqtt", "the broker should have answered at least"),
    ("mqtt-handle", "makes-up-for-it"): (
        "S11 R-mqtt",
        "was not told as a success and should never have been published",
    ),
    ("mqtt-handle", "guard-by-hiding"): ("Q3", "the broker should have seen no PUBLISH from the adapter, it saw 1"),
    ("mqtt-handle", "empty-poll"): ("Q2 S2", "should be there once"),
    ("mqtt-handle", "hangs-on-nonsense"): ("FQ1", "no reply within the deadline"),
    ("mqtt-session", "first-watch"): ("S2", "should be there once"),
    ("mqtt-session", "same-session"): ("S11 R-mqtt", "expected success"),
    ("mqtt-payloads", "no-payloads"): ("Q2 S2", "should be there once"),
    ("mqtt-payloads", "of-all-topics"): ("S2", "should not be there, it came on another topic than 'stress/"),
    ("mqtt-collect", "collects-nothing"): ("Q2 S2", "the reply says []"),
    ("opcua-items", "empty-success"): ("O2 O4", "nodes are missing or wrong"),
    ("opcua-items", "guard-in-words"): ("O3", "the server should have seen no state-changing request, it saw 1"),
    ("opcua-items", "echoes-write"): ("O3 FO2 S6 R-opcua", "the server should have seen one Write"),
    ("opcua-items", "all-is-good"): ("FO1", "it claims success"),
    ("opcua-items", "applied-late"): ("FO2", "should have accepted 1 Write(s), it accepted 2"),
    ("opcua-items", "applied-nevertheless"): ("FO2", "ns=2;s=ValvePosition should hold"),
}


@pytest.mark.parametrize(
    ("name", "lie"),
    [pytest.param(name, lie, marks=lane(number, lie in QUICK[name])) for number, (name, lie) in enumerate(LIES)],
)
def test_a_lie_fails_exactly_its_tasks(judge_foreign: Judge, name: str, lie: str) -> None:
    tasks, reason = LIES[name, lie]
    results = judge_foreign(name, lie=lie, time_scale=IMPATIENT if lie.startswith("hangs") else 1.0)
    assert failing(results) == set(tasks.split()), words(results)
    assert reason in words(results)
    assert {result["status"] for result in results.values()} <= {"PASS", "FAIL", "NOT_APPLICABLE"}


NEIGHBOURS = [
    # What is bent is no lie: each is close to what a check forbids, and keeps it.
    (
        "mqtt-handle",
        "refuses-null",
        "ADR-007.mqtt FQ2",
        ('"^invalid", code = "invalid_input"', '"^invalid", code = "range_overflow"'),
    ),
    ("mqtt-handle", None, "ENV-003.mqtt", None),
    ("mqtt-connect", None, "ERR-005.mqtt TMO-003.mqtt", None),
    ("opcua-items", None, "TMO-003.opcua", None),
    ("opcua-items", "writes-no-booleans", "CON-004.opcua", None),
    ("modbus-prose", None, "WR-012.modbus", None),
    ("modbus-prose", "reads-back", "WR-012.modbus", None),
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "lie", "tasks", "described"), NEIGHBOURS)
def test_an_adapter_that_is_close_to_what_a_check_forbids_passes_it(
    judge_foreign: Judge, name: str, lie: str | None, tasks: str, described: tuple[str, str] | None
) -> None:
    results = judge_foreign(name, lie=lie, tasks=tasks, described=described)
    assert passing(results) == set(tasks.split()), words(results)


LISTS = "result.node_ids = \"items[?class == 'Variable'].node\""


@pytest.mark.long
@pytest.mark.parametrize(("lie", "accused"), [("first-page", False), ("first-page-as-all", True)])
def test_a_list_that_says_that_it_is_a_part_may_be_one(judge_foreign: Judge, lie: str, accused: bool) -> None:
    described = LISTS, f'{LISTS}\nresult.truncated = "more"'
    results = judge_foreign("opcua-items", lie=lie, tasks="OUA-006.opcua", described=described)
    assert ("or the answer should say that it is a part" in words(results)) is accused, words(results)


TOO_EARLY = {
    ("mqtt-handle", "publishes-later"): ("CON-004.mqtt TMO-004.mqtt", "MQT-001"),
    ("mqtt-handle", "subscribes-later"): ("CON-006.mqtt", "MQT-002"),
}


@pytest.mark.parametrize(
    ("name", "lie"),
    [pytest.param(*told, marks=pytest.mark.long if number else ()) for number, told in enumerate(TOO_EARLY)],
)
def test_a_success_before_the_request_is_told_as_such_and_not_as_a_lost_one(
    judge_foreign: Judge, name: str, lie: str
) -> None:
    tasks, cited = TOO_EARLY[name, lie]
    results = judge_foreign(name, lie=lie, tasks=tasks)
    assert failing(results) == set(tasks.split()), words(results)
    assert "it claims success, and the device saw the request only after that" in words(results)
    assert requirements(results) == {cited}, words(results)


@pytest.mark.long
def test_what_is_never_acknowledged_may_leave_after_the_answer(judge_foreign: Judge) -> None:
    # QoS 0: what is bent is no lie.
    results = judge_foreign("mqtt-connect", lie="publishes-later", tasks="CON-004.mqtt TMO-004.mqtt")
    assert failing(results) == set(), words(results)


def test_an_item_that_is_missing_from_several_is_missed(judge_foreign: Judge) -> None:
    names = ("modbus-prose", "mqtt-connect", "opcua-items")
    results = judge_foreign(*names, lie="partial-read", tasks="X1 X2 X1p X2p FX1")
    assert failing(results) == {"X1", "X1p"}, words(results)
    assert "values should be" in words(results)


MISDESCRIBED = {
    # This adapter accepts wrong addresses, so a wrong subject file looks like a wrong adapter: the device shows it.
    "offset-forgotten": ("modbus-prose", "forgives-offset", ("offset = { address = 30001 }\n", ""), "M2 S1 S7 S10"),
    # The schema of this adapter's tool allows arguments that it does not name, and the server drops them.
    "argument-misspelt": ("modbus-json", None, ("length = ", "lenght = "), "M2 S10"),
}


@pytest.mark.long
@pytest.mark.parametrize("case", MISDESCRIBED)
def test_a_subject_file_that_asks_for_something_else_cannot_pass(judge_foreign: Judge, case: str) -> None:
    name, lie, described, tasks = MISDESCRIBED[case]
    results = judge_foreign(name, lie=lie, described=described)
    assert failing(results) == set(tasks.split()), words(results)
    assert "the device should have been asked for 4 cell(s) from 0 by function 4 during the call, it was not" in words(
        results
    )
