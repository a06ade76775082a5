"""What holds for every call: ``meta`` against the journal, writes that nobody asked for, and what whole items and sessions show."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import pytest

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.journal import JournalEntry
from pytest_otmcp.protocols.mqtt.oracle import Refused
from pytest_otmcp.protocols.mqtt.sparkplug_oracle import SparkplugSequence
from pytest_otmcp.protocols.protocol import OtProtocol
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.protocols.stamp import Stamp
from pytest_otmcp.session.exchange import Exchange
from pytest_otmcp.trial.asked_for import AskedFor
from pytest_otmcp.trial.call_windows import windows
from pytest_otmcp.trial.connections import connections_left
from pytest_otmcp.trial.ledger import Judged
from pytest_otmcp.trial.meta_claims import meta_faults
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.start_times import StartTimes
from pytest_otmcp.trial.tool_listing import listing_faults
from pytest_otmcp.trial.unasked_writes import delivered_before, unasked_writes

from ..feeding import fed

MODBUS, MQTT = protocols()["modbus"], protocols()["mqtt"]
ENDPOINT = "modbus+tcp://localhost:502"


def call(operation: str = "read_input", *, at: int = 1, error: dict[str, Any] | None = None, **meta: Any) -> Judged:
    """Return a call that took the millisecond ``at``."""
    stated = {"endpoint": ENDPOINT, "attempts": 1, "source": "device", "latency_ms": 0.9, "trace": {}, **meta}
    exchange = Exchange(tool=operation, arguments={}, response=b"{}", sent_ns=at * 10**6, received_ns=(at + 1) * 10**6)
    reply = Reply(
        adapter="modbus",
        variant="rw",
        operation=operation,
        exchange=exchange,
        envelope={"success": error is None, "error": error, "meta": stated},
        outputs={},
    )
    return Judged(reply=reply, inputs={}, role="task", group=at)


def entry(ms: float, kind: str = "request", function: int = 4, **fields: Any) -> JournalEntry:
    common = {"seq": round(ms * 100), "t_ns": round(ms * 10**6), "connection": 1, "kind": kind, "origin": "client"}
    request = kind == "request"
    asks = {"direction": "out" if kind == "response" else "in", "request": request, "answers": None}
    says = {"state_changing": request and function == 6, "unit": 1, "transaction_id": 7, "function": function}
    address = {"address": 0, "quantity": 4} if request else {}
    return cast(JournalEntry, {**common, **asks, **says, **address, **fields})


def exchange(ms: float, *, took_ms: float = 0.1, **fields: Any) -> list[JournalEntry]:
    asked = entry(ms, **fields)
    return [asked, entry(ms + took_ms, "response", answers=asked["seq"])]


def claims(
    judged: Judged, *entries: JournalEntry, addresses: tuple[tuple[str, int], ...] = (("127.0.0.1", 502),)
) -> list[str]:
    (window,) = windows([judged], entries)
    found = meta_faults(window, judged, protocol=MODBUS, declared={}, addresses=addresses)
    return [f"{finding.code} {finding.requirement}" for finding in found]


def test_an_envelope_that_says_what_the_device_saw_is_right() -> None:
    trace = {"unit": 1, "function": 4, "address": 0, "transaction_ids": [7], "exception_code": None}
    assert claims(call(trace=trace), *exchange(1.2)) == []


@pytest.mark.parametrize(
    ("meta", "found"),
    [
        ({"attempts": 2}, "attempts ENV-005"),
        ({"endpoint": "modbus+tcp://localhost:503"}, "other_endpoint ENV-006"),
        ({"endpoint": "modbus+tcp://10.0.0.1:502"}, "other_endpoint ENV-006"),
        ({"trace": {"address": 1}}, "trace_differs ENV-007"),
        ({"trace": {"transaction_ids": [7, 8]}}, "trace_differs ENV-007"),
        ({"trace": {"exception_code": 2}}, "trace_differs ENV-007"),
    ],
)
def test_what_an_envelope_says_of_its_exchange_is_compared(meta: dict[str, Any], found: str) -> None:
    assert claims(call(**meta), *exchange(1.2)) == [found]


def test_data_of_the_device_need_an_exchange_with_it() -> None:
    assert claims(call(attempts=0)) == ["source_without_traffic ENV-008"]
    assert claims(call(attempts=0, source="none")) == []


def test_a_refusal_in_the_adapter_has_no_attempt() -> None:
    assert claims(call(source="none")) == ["attempts ENV-005"]


@pytest.mark.parametrize(
    ("next_attempts", "during_next", "found"),
    [
        # The one message that nobody answered is what the next call says it sent.
        (1, [entry(2.2)], ["attempts ENV-005"]),
        # It is one more than that: it may have been on its way when the first reply came.
        (1, [entry(2.2), *exchange(2.4)], []),
        (0, [entry(2.2)], []),
        # What is answered is a request of the call during which it is answered.
        (1, [*exchange(2.2), *exchange(2.4)], ["attempts ENV-005"]),
    ],
)
def test_a_message_that_comes_after_the_reply_is_not_taken_from_the_next_call(
    next_attempts: int, during_next: list[JournalEntry], found: list[str]
) -> None:
    first, following = call(source="none"), call(at=2, attempts=next_attempts)
    window, _ = windows([first, following], during_next)
    judged = meta_faults(window, first, protocol=MODBUS, declared={}, addresses=())
    assert [f"{finding.code} {finding.requirement}" for finding in judged] == found


def test_more_requests_than_attempts_may_be_the_adapters_own_questions() -> None:
    assert claims(call(), *exchange(1.2), *exchange(1.5, address=100)) == []


def test_an_exchange_that_the_device_tells_of_once_may_be_repeated_by_a_call() -> None:
    before = entry(0.5, "cycle")
    assert claims(call(), before) == []
    assert claims(call(attempts=2), before) == ["attempts ENV-005"]
    assert claims(call(), entry(0.5)) == ["source_without_traffic ENV-008"]


def test_a_new_connection_or_a_device_that_is_down_hides_attempts() -> None:
    assert claims(call(attempts=2), entry(1.1, "CONNECTED"), *exchange(1.2)) == []
    assert claims(replace(call(source="none"), reachable=False)) == []


def test_requests_that_the_device_may_never_have_read_are_not_compared() -> None:
    again = call(attempts=2, trace={"transaction_ids": [6, 7]})
    assert claims(again, *exchange(1.2)) == ["attempts ENV-005", "trace_differs ENV-007"]
    assert claims(again, entry(1.1, "lost", count=12), *exchange(1.2)) == []
    # The first went to a connection that had ended.
    assert claims(again, entry(1.1, "CONNECTED"), *exchange(1.2)) == []
    assert claims(call(trace={"transaction_ids": [6]}), entry(1.1, "CONNECTED"), *exchange(1.2)) == [
        "trace_differs ENV-007"
    ]


def test_less_attempts_than_writes_are_a_lie() -> None:
    twice = [*exchange(1.2, function=6), *exchange(1.5, function=6)]
    assert claims(call("write_holding"), *twice) == ["attempts ENV-005"]
    assert claims(call("write_holding", attempts=2), *twice) == []


def test_a_latency_below_what_the_device_took_is_a_lie() -> None:
    assert claims(call(latency_ms=0.1), *exchange(1.1, took_ms=0.8)) == []
    slow = call(latency_ms=0.1)
    slow = replace(slow, reply=replace(slow.reply, exchange=replace(slow.reply.exchange, received_ns=10**9)))
    assert claims(slow, *exchange(1.1, took_ms=100.0)) == ["latency_below_device ENV-004"]


def unasked(
    protocol: OtProtocol,
    calls: list[Judged],
    entries: Sequence[JournalEntry],
    *,
    variant: str = "rw",
    asked_for: AskedFor | None = None,
    item: str = "X-1",
) -> list[tuple[Finding, Judged | None]]:
    made = windows(calls, entries)
    before = asked_for or AskedFor()
    found = unasked_writes(made, entries, protocol=protocol, declared={}, variant=variant, asked_for=before, item=item)
    return list(found)


def strays(*entries: JournalEntry, calls: list[Judged], variant: str = "rw") -> list[str | None]:
    found = unasked(MODBUS, calls, entries, variant=variant)
    return [finding.requirement for finding, _ in found]


REFUSED = {"code": "writes_disabled", "outcome": "not_sent"}
FAILED = {"code": "timeout", "outcome": "unknown"}


@pytest.mark.parametrize(
    ("calls", "times", "variant", "found"),
    [
        ([call("write_holding")], [1.5], "rw", []),
        ([call("write_holding", error=FAILED)], [1.5], "rw", []),
        ([call("write_holding"), call(at=5)], [5.5], "rw", []),
        ([call("write_holding")], [1.4, 1.6], "rw", ["WR-003"]),
        ([call("write_holding", error=REFUSED)], [1.5], "ro", ["WR-004"]),
        ([call("write_holding", error={**FAILED, "outcome": "not_sent"})], [1.5], "rw", ["ERR-006"]),
        ([call("write_holding", error=FAILED), call(at=5)], [5.5], "rw", ["WR-010"]),
        ([call()], [1.5], "rw", ["MCP-008"]),
        ([call()], [1.5], "ro", ["WR-004"]),
        ([call()], [3.0], "rw", ["MCP-008"]),
        ([call()], [300.0], "rw", ["WR-004"]),
        ([call(at=5)], [1.5], "rw", ["WR-004"]),
    ],
)
def test_every_write_at_the_device_was_asked_for(
    calls: list[Judged], times: list[float], variant: str, found: list[str]
) -> None:
    assert strays(*(entry(ms, function=6) for ms in times), calls=calls, variant=variant) == found


@pytest.mark.parametrize("late", [4711, 4712, 4713])
def test_a_late_write_is_of_the_failed_call_that_asked_for_its_value(late: int) -> None:
    made = [call("write_holding", at=1, error=FAILED), call("write_holding", at=3, error=FAILED), call(at=200)]
    named = [
        replace(
            one,
            inputs={"unit": 1, "address": 7, "value": value},
            reply=replace(one.reply, exchange=replace(one.reply.exchange, arguments={"value": value})),
        )
        for one, value in zip(made, (4711, 4712), strict=False)
    ]
    ((found, _),) = unasked(MODBUS, [*named, made[-1]], [entry(201, function=6, address=7, values=[late])])
    # A value that nobody asked for is of the last call.
    assert f"value={min(late, 4712)}" in found.message
    assert found.requirement == "WR-010"


def message(ms: float, **fields: Any) -> JournalEntry:
    asks = {"kind": "PUBLISH", "direction": "in", "request": True, "state_changing": True, "answers": None}
    says = {
        "topic": "control/pump",
        "payload": base64.b64encode(b"on").decode(),
        "qos": 1,
        "retain": False,
        "dup": False,
    }
    where = {"seq": round(ms * 100), "t_ns": round(ms * 10**6), "connection": 1, "origin": "client", "packet_id": 1}
    return cast(JournalEntry, {**asks, **says, **where, **fields})


def test_a_message_that_is_delivered_again_while_a_call_reads_is_of_the_call_that_published_it() -> None:
    calls = [call("publish", at=1), call("messages", at=3)]

    def found(again: JournalEntry) -> list[tuple[str | None, bool, bool]]:
        entries = [message(1.5, fault={"reset": True}), again]
        strays = unasked(MQTT, calls, entries)
        return [(finding.requirement, "with DUP" in finding.message, reader is None) for finding, reader in strays]

    # To the broker a new client is nobody who delivers something again.
    assert found(message(3.5, dup=True, connection=2, client_id="new")) == [("WR-003", True, True)]
    # Another message is the reading call's own.
    other = base64.b64encode(b"off").decode()
    assert found(message(3.5, dup=True, payload=other)) == [("MCP-008", False, False)]


def test_a_message_of_an_earlier_item_that_is_delivered_again_is_of_the_call_that_published_it() -> None:
    before = AskedFor()
    assert unasked(MQTT, [call("publish", at=1)], [message(1.5, fault={"no_answer": True})], asked_for=before) == []
    again = message(3.5, dup=True, connection=2, client_id="new")
    other = base64.b64encode(b"off").decode()

    def found(calls: list[Judged], *entries: JournalEntry) -> list[tuple[str | None, bool]]:
        strays = unasked(MQTT, calls, entries, asked_for=before, item="X-2")
        return [(one.requirement, "publish(): one write was asked for in X-1, the" in one.message) for one, _ in strays]

    assert found([call("messages", at=3)], again) == [("WR-003", True)]
    # Also where another message is published meanwhile, which is asked for.
    assert found([call("publish", at=3)], again, message(3.6, payload=other)) == [("WR-003", True)]
    # What is not marked was asked for.
    assert found([call("publish", at=3)], message(3.5)) == []
    told, others = delivered_before([again, message(4.5, payload=other)], MQTT, asked_for=before, item="X-3")
    assert [(one.requirement, "when nobody called" in one.message) for one in told] == [("WR-003", True)]
    assert [entry["t_ns"] for entry in others] == [4_500_000]


def test_a_message_that_nobody_answers_may_arrive_after_its_item() -> None:
    def arriving(*entries: JournalEntry, calls: list[Judged]) -> list[int]:
        before = AskedFor()
        assert unasked(MQTT, calls, [], asked_for=before) == []
        again, others = delivered_before(list(entries), MQTT, asked_for=before, item="X-2")
        assert again == []
        return [entry["t_ns"] // 10**6 for entry in others]

    published, late = [call("publish", at=1)], message(4, qos=0)
    assert arriving(late, calls=published) == []
    assert arriving(late, message(5, qos=0), calls=published) == [5]
    assert arriving(late, calls=[call("messages", at=1)]) == [4]
    assert arriving(late, calls=[call("publish", at=1, error=FAILED)]) == [4]
    # The broker has answered: the call was no success before.
    acknowledged = message(
        4.1, kind="PUBACK", direction="out", request=False, state_changing=False, answers=late["seq"]
    )
    assert arriving(late, acknowledged, calls=published) == [4, 4]


def test_a_message_on_its_way_at_the_end_of_a_repetition_is_of_the_next_one_only() -> None:
    before = AskedFor()
    assert unasked(MQTT, [call("publish", at=1)], [], asked_for=before) == []
    assert unasked(MQTT, [call("messages", at=3)], [], asked_for=before) == []
    (stray,) = unasked(MQTT, [call("messages", at=5)], [message(5.5, qos=0)], asked_for=before)
    assert stray[0].requirement == "MCP-008"
    assert unasked(MQTT, [call("publish", at=7)], [], asked_for=before) == []
    assert unasked(MQTT, [call("messages", at=9)], [message(9.5, qos=0)], asked_for=before) == []


def without_reply(failure: str) -> Judged:
    made = call("write_holding")
    silent = replace(made.reply.exchange, response=None, received_ns=None, failure=failure)
    return replace(made, reply=replace(made.reply, exchange=silent, envelope=None))


@pytest.mark.parametrize(
    ("failure", "times", "found"),
    [
        ("cancelled", [], []),
        ("cancelled", [1.5], []),
        # It may have been on its way.
        ("cancelled", [90.0], []),
        ("cancelled", [205.0], [("cancelled_write", "TMO-003", "SHOULD")]),
        ("cancelled", [1.5, 205.0], [("unasked_write", "TMO-003", "MUST")]),
        (
            "cancelled",
            [203.0, 205.0],
            [("cancelled_write", "TMO-003", "SHOULD"), ("unasked_write", "TMO-003", "MUST")],
        ),
        ("timeout", [205.0], [("unasked_write", "TMO-001", "MUST")]),
    ],
)
def test_a_write_after_its_cancellation_is_a_warning_and_a_second_one_is_none(
    failure: str, times: list[float], found: list[tuple[str, str, str]]
) -> None:
    calls, entries = [without_reply(failure), call(at=200)], [entry(ms, function=6) for ms in times]
    seen = unasked(MODBUS, calls, entries)
    assert [(one.code, one.requirement, one.strength) for one, _ in seen] == found
    assert not any("reported as failed" in one.message for one, _ in seen)


def started(stated: str, *, ended_at: str = "2026-11-22T06:00:10.000Z") -> list[Finding]:
    times = StartTimes("2026-11-22T06:00:00.000Z", 0)
    times.look(call(at=1000, started_at=stated))
    return times.faults(ended_at, 10 * 10**9)


def told(ms: int, *, oldest_s: float = 60.0, ended_at: str = "2026-11-22T06:00:10.000Z") -> list[Finding]:
    """Judge a message that the device received five seconds after six o'clock."""
    times = StartTimes("2026-11-22T06:00:00.000Z", 0)
    stamp = Stamp(of="DDATA", ms=ms, seen_ns=5 * 10**9, oldest_s=oldest_s, requirement="SPB-001")
    times.compare("mqtt", stamp)
    return times.faults(ended_at, 10 * 10**9)


FIVE_PAST = 1_795_327_205_000
"""2026-11-22T06:00:05Z in milliseconds since 1970."""


def test_a_time_on_the_wire_is_compared_with_the_moment_at_which_the_device_received_it() -> None:
    assert told(FIVE_PAST) == told(FIVE_PAST - 59_000) == told(FIVE_PAST + 59_000) == []
    assert told(FIVE_PAST - 3_600_000, oldest_s=86_400.0) == []
    for wrong in (FIVE_PAST // 1000, FIVE_PAST - 61_000, FIVE_PAST + 61_000, 2**64 - 1):
        [found] = told(wrong)
        assert (found.code, found.requirement) == ("time_off", "SPB-001")
        assert "the device received it at 2026-11-22T06:00:05.000Z" in found.message


def test_a_clock_that_was_set_during_the_item_accuses_no_time_on_the_wire() -> None:
    assert told(0, ended_at="2026-11-22T07:00:10.000Z") == []


def test_a_call_starts_when_it_is_made() -> None:
    assert started("2026-11-22T06:00:01.000Z") == []
    assert started("2026-11-22T07:00:01.000+01:00") == []
    assert [finding.requirement for finding in started("2026-11-22T15:00:01.000Z")] == ["ENC-007"]
    # The wall clock was set by an hour during the item.
    assert started("2026-11-22T15:00:01.000Z", ended_at="2026-11-22T07:00:10.000Z") == []


@pytest.mark.parametrize(
    ("listing", "writes", "found"),
    [
        ({"inputSchema": {"type": "object", "properties": {"address": {}}}}, False, []),
        ({"inputSchema": {"type": "object", "$ref": "#/$defs/Read"}}, False, []),
        ({"inputSchema": {"type": "object"}}, False, ["MCP-003"]),
        ({"inputSchema": {"properties": {"address": {}}}}, False, ["MCP-003"]),
        ({"inputSchema": None}, False, ["MCP-003"]),
        (
            {"inputSchema": {"type": "object", "properties": {"a": {}}}, "annotations": {"readOnlyHint": True}},
            True,
            ["MCP-008"],
        ),
    ],
)
def test_a_tool_is_listed_as_what_it_is_used_for(listing: dict[str, Any], writes: bool, found: list[str]) -> None:
    faults = listing_faults("tool", listing, arguments=["address"], writes=writes)
    assert [finding.requirement for finding in faults] == found


@pytest.mark.parametrize(
    ("hints", "adds", "warned"),
    [
        ({}, False, False),
        ({"destructiveHint": True, "idempotentHint": True}, False, False),
        ({"destructiveHint": False}, False, True),
        ({"destructiveHint": False}, True, False),
        ({"idempotentHint": False}, True, False),
        ({"idempotentHint": True}, True, True),
    ],
)
def test_the_hints_of_a_tool_that_writes_should_be_true(hints: dict[str, Any], adds: bool, warned: bool) -> None:
    listing = {"inputSchema": {"type": "object", "properties": {"a": {}}}, "annotations": hints}
    faults = list(listing_faults("tool", listing, arguments=["a"], writes=True, adds=adds))
    assert [(fault.requirement, fault.strength) for fault in faults] == [("MCP-008", "SHOULD")] * warned
    assert list(listing_faults("tool", listing, arguments=["a"], writes=False, adds=adds)) == []


def test_a_tool_without_arguments_may_declare_none() -> None:
    assert list(listing_faults("ping", {"inputSchema": {"type": "object"}}, arguments=[], writes=False)) == []


def test_connections_that_are_left_open_are_counted() -> None:
    opened = [entry(number, "CONNECTED", connection=number) for number in range(1, 20)]
    closed = [entry(number, "DISCONNECTED", connection=number) for number in range(1, 15)]
    assert [finding.requirement for finding in connections_left(opened)] == ["CON-006"]
    assert connections_left([*opened, *closed]) == []


def published(payload: str) -> dict[str, Any]:
    said = {"topic": "line/late", "qos": 0, "retain": False, "payload": payload}
    return {**entry(1.0, "PUBLISH"), **said, "client_id": "a"}


def test_a_refused_message_is_found_once_also_after_a_restart() -> None:
    oracle = Refused()
    oracle.never(b"late")
    following = oracle.restarted()
    assert [finding.requirement for finding in fed(following, [published("bGF0ZQ==")] * 2).take_faults()] == ["WR-010"]
    assert following.take_faults() == []


def test_a_restart_does_not_make_bd_seq_begin_anew() -> None:
    def connect(bd_seq: int) -> dict[str, Any]:
        # One metric: its name, its data type Int64, its value.
        metric = b"\x0a\x05bdSeq\x20\x04\x58" + bytes([bd_seq])
        payload = base64.b64encode(b"\x12" + bytes([len(metric)]) + metric).decode()
        will = {"topic": "spBv1.0/g/NDEATH/e", "qos": 1, "retain": False, "payload": payload}
        return {**entry(1.0, "CONNECT"), "client_id": "a", "will": will, "clean_start": True}

    counted = fed(fed(SparkplugSequence(), [connect(0)]).restarted(), [connect(1), connect(2)])
    assert counted.take_faults() == []
    constant = fed(fed(SparkplugSequence(), [connect(0)]).restarted(), [connect(0)])
    assert [finding.requirement for finding in constant.take_faults()] == ["SPB-006"]
    assert constant.take_faults() == []
