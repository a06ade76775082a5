"""What is noted of others than the adapter under test, and when they leave nothing to be judged."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.report.console import summary
from pytest_otmcp.report.html import page
from pytest_otmcp.report.markdown import summary as markdown
from pytest_otmcp.report.strangers import strangers
from pytest_otmcp.trial.strangers import Strangers

from .journals import entry, numbered
from .samples import item, run

CURL = {"pid": 4242, "name": "curl"}
WRITE: dict[str, Any] = {
    **{"request": True, "state_changing": True, "unit": 1, "transaction_id": 1},
    **{"function": 6, "address": 1, "quantity": 1, "values": [7]},
}
RESPONSE = {"unit": 1, "transaction_id": 1, "function": 6}


def message(topic: str, *, retain: bool) -> dict[str, Any]:
    publish = {"topic": topic, "payload": "b24=", "qos": 0, "retain": retain}
    return {"request": True, "state_changing": True, **publish}


def watched(at: str, *entries: Any, before: bool = False) -> Strangers:
    found = Strangers()
    found.take(at, numbered(*entries), watched=not before)
    return found


def test_a_stranger_is_noted_with_what_it_sent() -> None:
    common = {"origin": "stranger", "process": CURL}
    found = watched(
        "modbus",
        entry("CONNECTED", **common),
        entry("malformed", bytes=b"GET / HTTP/1.1\r\n".hex(), **common),
        entry("DISCONNECTED", **common),
        entry("CONNECTED", connection=2),
        entry("request", connection=2, **WRITE),
    )
    assert found.noted() == [
        {
            **{"at": "modbus", "origin": "stranger", "program": "curl", "connections": 1, "messages": 1},
            "sent": ["b'GET / HTTP/1.1\\r\\n', which is no message of the protocol"],
        }
    ]
    assert found.disturbance is None


def test_without_strangers_there_is_nothing_to_say() -> None:
    found = watched("modbus", entry("CONNECTED"), entry("request", **WRITE), entry("PUBLISH", origin="plant"))
    assert (found.noted(), found.disturbance) == ([], None)


@pytest.mark.parametrize(
    ("at", "kind", "fields", "answer", "disturbs"),
    [
        ("modbus", "request", WRITE, {"exception": None}, True),
        ("modbus@ro", "request", WRITE, {"exception": None}, True),
        ("modbus", "request", WRITE, {"exception": 2}, False),
        ("modbus", "request", {**WRITE, "state_changing": False, "function": 3}, {"exception": None}, False),
        ("opcua", "Write", {"request": True, "state_changing": True}, {"results": [{"status": "Good"}]}, True),
        ("opcua", "Write", {"request": True, "state_changing": True}, {"results": ["BadTypeMismatch"]}, False),
        ("opcua", "Call", {"request": True, "state_changing": True}, {"service_result": "BadTimeout"}, False),
        ("opcua", "Write", {"request": True, "state_changing": True}, None, False),
        ("mqtt", "PUBLISH", message("control/pump", retain=False), None, False),
        ("mqtt", "PUBLISH", message("control/pump", retain=True), None, True),
        ("mqtt", "PUBLISH", message("spBv1.0/factory/DCMD/edge-node-1/device-1", retain=False), None, True),
        ("mqtt", "PUBLISH", message("spBv1.0/factory/DDATA/other/device-1", retain=False), None, False),
    ],
)
def test_an_item_is_disturbed_by_what_a_stranger_really_changed(
    at: str, kind: str, fields: dict[str, Any], answer: dict[str, Any] | None, disturbs: bool
) -> None:
    common = {"origin": "stranger", "process": CURL}
    entries = [entry(kind, **fields, **common)]
    if answer is not None:
        entries.append(entry("response", "out", answers=0, **common, **(RESPONSE | answer)))
    found = watched(at, *entries)
    assert (found.disturbance is not None) == disturbs
    if disturbs:
        assert str(found.disturbance).startswith(f"another program, curl (process 4242), changed the device of {at}")
    # What was changed before the item is brought back when it begins.
    assert watched(at, *entries, before=True).disturbance is None


def test_an_answer_that_comes_later_decides_unless_the_device_was_started_anew_meanwhile() -> None:
    common = {"origin": "stranger", "process": CURL}
    write = entry("request", **WRITE, **common) | {"seq": 7}
    answer = entry("response", "out", answers=7, **common, **RESPONSE) | {"seq": 8}
    found = watched("modbus", entry("CONNECTED", **common))
    found.take("modbus", [write])
    assert found.disturbance is None
    found.take("modbus", [answer])
    assert found.disturbance is not None
    again = Strangers()
    again.take("modbus", [write])
    again.take("modbus", numbered(entry("CONNECTED")))
    again.take("modbus", [answer])
    assert again.disturbance is None


@pytest.mark.parametrize(("topic", "disturbs"), [("adapter/status", False), ("control/pump", True)])
def test_what_an_adapter_tells_of_itself_as_it_ends_disturbs_nothing(topic: str, disturbs: bool) -> None:
    last_words = entry("PUBLISH", origin="former", process=CURL, **message(topic, retain=True))
    assert (watched("mqtt", last_words).disturbance is not None) == disturbs


def test_that_a_former_session_leaves_and_that_an_unknown_client_came_is_not_worth_a_note() -> None:
    left = [entry(kind, origin="former", process=CURL) for kind in ("DISCONNECT", "DISCONNECTED")]
    assert watched("mqtt", *left, entry("CONNECTED", origin="unknown", connection=2)).noted() == []
    (silent,) = watched("mqtt", entry("DISCONNECTED", origin="unknown")).noted()
    assert (silent["program"], silent["messages"]) == (None, 0)


def test_reports_say_once_who_was_there() -> None:
    def seen(program: str | None, origin: str = "stranger") -> dict[str, Any]:
        counts = {"connections": 2, "messages": 2, "sent": ["< PINGREQ"]}
        return {"at": "mqtt", "origin": origin, "program": program, **counts}

    items = [
        {**item(name, "normal", "MQTT", "Publish.", [1.0]), "strangers": [seen("curl<b>"), seen("node", "former")]}
        for name in ("Q1", "Q2", "Q3", "Q4", "FQ1", "S2")
    ]
    items[0]["strangers"] += [seen(None, "unknown")]
    record = run(items)
    stranger, former, unknown = strangers(record)
    assert stranger == (
        "a stranger (curl<b>) connected to the device of mqtt 12 times in Q1, Q2, Q3, Q4, FQ1 and 1 more and sent "
        "< PINGREQ; ignored"
    )
    assert "a process of a session that was over (node) still spoke to the device of mqtt" in former
    assert unknown == (
        "an unidentified client (gone before its process could be identified) connected to the device of mqtt "
        "2 times in Q1 and sent < PINGREQ; ignored"
    )
    lines = [line for line, _ in summary(record, 400)]
    assert f"note: {stranger}" in lines
    assert "curl&lt;b&gt;" in page(record)
    assert "Note: a stranger" in markdown(record)
