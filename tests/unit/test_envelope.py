"""The envelope: strict reading, and each rule with a result that keeps it and one that breaks it."""

from __future__ import annotations

import contextlib
import copy
import json
import random
import re
from collections.abc import Callable
from typing import Any

import pytest

from pytest_otmcp.core.strict_json import parse_strict, same_json
from pytest_otmcp.protocols.envelope import check_result

Envelope = dict[str, Any]

META: Envelope = {
    "schema": "otmcp/1.0",
    "protocol": "modbus-tcp",
    "operation": "read_holding",
    "endpoint": "modbus+tcp://127.0.0.1:1502",
    "started_at": "2026-11-21T05:45:28.123Z",
    "latency_ms": 1.2,
    "attempts": 1,
    "request_id": "9f1c",
    "source": "device",
    "connection": {"state": "connected", "generation": 1},
    "trace": {"unit": 1, "function": 3, "address": 0, "count": 1},
}
SUCCESS: Envelope = {"success": True, "data": {"values": [1, 2.5]}, "error": None, "meta": META}
ERROR: Envelope = {
    "code": "illegal_address",
    "class": "device",
    "message": "the device has no register 9999 (exception 02)",
    "retryable": False,
    "outcome": "not_applicable",
}
FAILURE: Envelope = {"success": False, "data": None, "error": ERROR, "meta": META}

UNKNOWN: Envelope = {
    **FAILURE,
    "error": {**ERROR, "code": "timeout", "class": "transport", "outcome": "unknown"},
}
OF_A_VENDOR: Envelope = {
    **FAILURE,
    "error": {**ERROR, "code": "x_approval_pending", "class": "policy", "outcome": "not_sent", "retryable": True},
}


def result_of(envelope: Any, **changes: Any) -> dict[str, Any]:
    result = {
        "content": [{"type": "text", "text": json.dumps(envelope)}],
        "structuredContent": envelope,
        "isError": not envelope.get("success"),
    }
    return {name: value for name, value in {**result, **changes}.items() if value is not Ellipsis}


def changed(envelope: Envelope, path: str, value: Any) -> Envelope:
    """Return a copy with one member replaced, or removed when the value is Ellipsis."""
    envelope = copy.deepcopy(envelope)
    *parents, last = path.split("/")
    at = envelope
    for parent in parents:
        at = at[parent]
    if value is Ellipsis:
        del at[last]
    else:
        at[last] = value
    return envelope


def found(result: dict[str, Any], **arguments: Any) -> list[tuple[str, str | None]]:
    return [(finding.code, finding.requirement) for finding in check_result(result, **arguments)]


# -- reading ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('{"a": NaN}', "NaN is no JSON number"),
        ('{"a": -Infinity}', "-Infinity is no JSON number"),
        ('{"a": 1, "b": 2, "a": 3}', "the member 'a' occurs twice"),
        (b'{"a": "\xff"}', "not UTF-8 at byte 7"),
        ('{"a": "\\ud800"}', "a string holds a lone surrogate"),
        ('["\\uDC00\\uD800"]', "a string holds a lone surrogate"),
        ('{"\\ud800": 1}', "a string holds a lone surrogate"),
        ("{'a': 1}", "Expecting property name enclosed in double quotes at character 1"),
        ("", "Expecting value at character 0"),
        ("{} {}", "Extra data at character 3"),
        ('"a\nb"', "Invalid control character at at character 2"),
    ],
)
def test_what_is_no_strict_json_is_refused_with_a_reason(text: bytes | str, reason: str) -> None:
    with pytest.raises(ValueError, match=re.escape(reason)) as caught:
        parse_strict(text)
    assert str(caught.value) == reason


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a":' * 100_000, "[" * 900 + "]" * 900])
def test_deep_nesting_is_refused_or_read_but_never_a_crash(text: str) -> None:
    with contextlib.suppress(ValueError):
        parse_strict(text)


def test_pairs_of_surrogates_and_numbers_beyond_double_precision_are_read() -> None:
    assert parse_strict(rb'["\ud83d\ude00", 18446744073709551615, "\u0000", -0.0]') == ["😀", 2**64 - 1, "\0", 0.0]


def test_a_number_that_overflows_to_infinity_is_refused() -> None:
    with pytest.raises(ValueError, match="1e400"):
        parse_strict('{"a": 1e400}')


def test_random_values_are_read_as_they_were_written() -> None:
    rng = random.Random(7)

    def value(depth: int) -> Any:
        kind = rng.randrange(7 if depth else 5)
        if kind == 5:
            return [value(depth - 1) for _ in range(rng.randrange(4))]
        if kind == 6:
            return {f"k{index}": value(depth - 1) for index in range(rng.randrange(4))}
        return [None, True, rng.randrange(-(2**70), 2**70), rng.uniform(-1e300, 1e300), "ä\u2028\x00"][kind]

    for _ in range(300):
        original = value(3)
        assert same_json(parse_strict(json.dumps(original)), original)
        assert same_json(parse_strict(json.dumps(original, ensure_ascii=False).encode()), original)


def test_equality_is_that_of_json() -> None:
    assert same_json({"a": [1, 2.0]}, {"a": [1.0, 2]})
    assert not same_json(True, 1)
    # As JavaScript writes a double into a text.
    assert same_json(8.078217585465754e16, "80782175854657540")
    assert not same_json(8.078217585465754e16, "80782175854657600")
    assert not same_json(7.0, "7")
    assert not same_json([0], [False])
    assert not same_json({"a": None}, {})
    assert not same_json([1], [1, 1])


# -- results that keep the rules --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "envelope",
    [
        SUCCESS,
        FAILURE,
        changed(FAILURE, "data", {"partial": [{"target": "a", "success": True}]}),
        changed(FAILURE, "error/code", "x_vendor_code"),
        changed(FAILURE, "error/retry_after_ms", 100),
        changed(SUCCESS, "meta/endpoint", "opc.tcp://plant.local:4840/server/"),
        changed(SUCCESS, "meta/endpoint", "mqtts://[::1]:8883"),
        changed(SUCCESS, "meta/vendor_extension", {"any": "thing"}),
        changed(SUCCESS, "data", {}),
        changed(SUCCESS, "data", {"error": None, "value": 1}),
        changed(SUCCESS, "data", {"error": "", "last_error": "timeout"}),
        UNKNOWN,
        OF_A_VENDOR,
        # What certainly did not happen, or changes nothing, may be repeated.
        changed(changed(UNKNOWN, "error/retryable", True), "error/outcome", "not_applicable"),
    ],
)
def test_a_proper_result_has_no_findings(envelope: Envelope) -> None:
    assert found(result_of(envelope), measured_latency_ms=1.3) == []


def test_an_absent_is_error_means_success() -> None:
    assert found(result_of(SUCCESS, isError=...)) == []
    assert found(result_of(FAILURE, isError=...)) == [("is_error", "MCP-006")]


# -- results that break one -------------------------------------------------------------------------------

ONE_FAULT: list[tuple[Callable[[], dict[str, Any]], list[tuple[str, str | None]]]] = [
    (lambda: {"content": [{"type": "text", "text": "42"}]}, [("no_envelope", "ENV-001")]),
    (lambda: result_of(SUCCESS, structuredContent=[1]), [("no_envelope", "ENV-001")]),
    (lambda: result_of(SUCCESS, isError=True), [("is_error", "MCP-006")]),
    (lambda: result_of(SUCCESS, isError=0), [("is_error", "MCP-006")]),
    (lambda: result_of(SUCCESS, content=[]), [("no_text", "MCP-006")]),
    (lambda: result_of(SUCCESS, content=[{"type": "text", "text": "done"}]), [("prose_text", "MCP-006")]),
    (lambda: result_of(SUCCESS, content=[{"type": "text", "text": '{"a": NaN}'}]), [("text_not_json", "ENV-003")]),
    (lambda: result_of(SUCCESS, content=[{"type": "text", "text": "{}"}]), [("renderings_differ", "MCP-006")]),
    (
        lambda: result_of(changed(SUCCESS, "data", {"on": True})) | {"structuredContent": changed(SUCCESS, "data", {"on": 1})},
        [("renderings_differ", "MCP-006")],
    ),
    (lambda: result_of(changed(SUCCESS, "data", [1])), [("envelope_schema", "ENV-001")]),
    (lambda: result_of(changed(SUCCESS, "extra", 1)), [("envelope_schema", "ENV-001")]),
    (lambda: result_of(changed(SUCCESS, "meta/trace", ...)), [("envelope_schema", "ENV-001")]),
    (lambda: result_of(changed(SUCCESS, "meta/latency_ms", -1)), [("envelope_schema", "ENV-001")]),
    (lambda: result_of(changed(SUCCESS, "meta/attempts", True)), [("envelope_schema", "ENV-001")]),
    (lambda: result_of(changed(SUCCESS, "meta/protocol", "modbus")), [("envelope_schema", "ENV-001")]),
    (lambda: result_of(changed(SUCCESS, "meta/connection/state", "up")), [("envelope_schema", "ENV-001")]),
    (lambda: result_of(changed(FAILURE, "error/outcome", "nothing")), [("envelope_schema", "ENV-001"), ("impossible_outcome", "ERR-006")]),
    (lambda: result_of(changed(FAILURE, "error/message", "x" * 501)), [("envelope_schema", "ENV-001")]),
    (lambda: result_of(changed(SUCCESS, "error", ERROR)), [("success_and_error", "ENV-002")]),
    (lambda: result_of(changed(FAILURE, "error", None)), [("success_and_error", "ENV-002")]),
    (lambda: result_of(changed(FAILURE, "data", {"value": 1})), [("data_on_failure", "ENV-002")]),
    (lambda: result_of(changed(FAILURE, "data", {})), [("data_on_failure", "ENV-002")]),
    (lambda: result_of(changed(SUCCESS, "data", {"error": "timeout"})), [("error_in_data", "ENV-002")]),
    (lambda: result_of(changed(SUCCESS, "data", {"success": False})), [("error_in_data", "ENV-002")]),
    (lambda: result_of(changed(UNKNOWN, "error/retryable", True)), [("unsafe_retry", "ENV-002")]),
    (lambda: result_of(changed(changed(OF_A_VENDOR, "error/outcome", "applied"), "error/retryable", False)), [("impossible_outcome", "ERR-006")]),
    (lambda: result_of(changed(FAILURE, "error/code", "made_up_code")), [("unknown_code", "ERR-001")]),
    (lambda: result_of(changed(FAILURE, "error/class", "policy")), [("wrong_class", "ERR-001")]),
    (lambda: result_of(changed(FAILURE, "error/retryable", True)), [("wrong_retryable", "ERR-001")]),
    (lambda: result_of(changed(FAILURE, "error/outcome", "applied")), [("impossible_outcome", "ERR-006")]),
    (lambda: result_of(changed(SUCCESS, "meta/endpoint", "mqtt://me:secret@127.0.0.1:1883")), [("credentials", "KEY-001")]),
    (lambda: result_of(changed(SUCCESS, "meta/endpoint", "None:None")), [("endpoint", "ENV-006")]),
    (lambda: result_of(changed(SUCCESS, "meta/endpoint", "mqtt://127.0.0.1")), [("endpoint", "ENV-006")]),
    (lambda: result_of(changed(SUCCESS, "meta/started_at", "2026-13-21T05:45:28Z")), [("started_at", "ENC-007")]),
    (lambda: result_of(changed(SUCCESS, "meta/started_at", "20261121Z")), [("started_at", "ENC-007")]),
    (lambda: result_of(changed(SUCCESS, "meta/attempts", 0)), [("source_without_exchange", "ENV-008")]),
]  # fmt: skip


@pytest.mark.parametrize("utc", ["Z", "+00:00", "-00:00"])
def test_every_spelling_of_utc_is_utc(utc: str) -> None:
    assert found(result_of(changed(SUCCESS, "meta/started_at", f"2026-11-21T05:45:28.123{utc}"))) == []


@pytest.mark.parametrize("other", ["", "+01:00", "-00:30"])
def test_a_time_that_is_not_said_in_utc_is_found(other: str) -> None:
    faults = found(result_of(changed(SUCCESS, "meta/started_at", f"2026-11-21T05:45:28.123{other}")))
    assert ("started_at", "ENC-007") in faults


@pytest.mark.parametrize(("result", "expected"), ONE_FAULT)
def test_a_result_that_breaks_a_rule_has_exactly_its_findings(
    result: Callable[[], dict[str, Any]], expected: list[tuple[str, str | None]]
) -> None:
    assert found(result()) == expected


@pytest.mark.parametrize(
    "message",
    [
        "Traceback (most recent call last): boom",
        'failed: File "x.py", line 3',
        "no reply from <pymodbus.client.tcp.ModbusTcpClient object at 0x7f00>",
        "see /usr/lib/python3/site.py",
        "C:\\Users\\plant\\adapter failed",
        "got ConnectionRefusedError(111, 'refused')",
        "no connection on None:None",
        "expected <class 'int'>",
    ],
)
def test_a_message_that_leaks_internals_is_found(message: str) -> None:
    assert found(result_of(changed(FAILURE, "error/message", message))) == [("leaky_message", "ENV-006")]


@pytest.mark.parametrize(
    "message",
    [
        "no connection to modbus+tcp://127.0.0.1:1502 could be made",
        "the topic plant/line 1/valve is not known",
        "the device answered with ILLEGAL DATA ADDRESS (exception 02), the error is final",
        "value < 10 is not allowed",
    ],
)
def test_a_plain_message_is_no_leak(message: str) -> None:
    assert found(result_of(changed(FAILURE, "error/message", message))) == []


def test_latency_must_lie_between_the_injected_delay_and_the_measured_time() -> None:
    result = result_of(changed(SUCCESS, "meta/latency_ms", 100.0))
    assert found(result, measured_latency_ms=101.0, injected_delay_ms=99.0) == []
    # A truthful clock may tick 64 times a second, and be rounded to whole milliseconds.
    assert found(result, measured_latency_ms=84.0) == []
    assert found(result, measured_latency_ms=83.0) == [("latency_too_long", "ENV-004")]
    assert found(result, injected_delay_ms=400.0) == [("latency_too_short", "ENV-004")]
    seconds = result_of(changed(SUCCESS, "meta/latency_ms", 0.1))
    assert found(seconds, measured_latency_ms=101.0, injected_delay_ms=99.0) == [("latency_too_short", "ENV-004")]


def test_what_the_text_should_be_is_a_warning_and_what_it_contradicts_is_not() -> None:
    def strengths(*texts: str) -> dict[str, str]:
        blocks = [{"type": "text", "text": text} for text in texts]
        return {finding.code: finding.strength for finding in check_result(result_of(SUCCESS, content=blocks))}

    rendering = json.dumps(SUCCESS)
    assert strengths() == {"no_text": "SHOULD"}
    assert strengths("All is well.", rendering) == strengths(rendering, "42") == {"prose_text": "SHOULD"}
    assert strengths(rendering, "{}") == {"renderings_differ": "MUST"}
    assert strengths(rendering, '{"success": true') == {"text_not_json": "MUST"}


def test_a_number_that_is_not_finite_is_found_where_it_is() -> None:
    result = result_of(SUCCESS)
    result["structuredContent"] = changed(SUCCESS, "data", {"values": [1.0, float("inf")]})
    findings = {finding.code: finding.message for finding in check_result(result)}
    assert findings["not_finite"] == "/data/values/1 is no finite number"


def test_nothing_can_have_happened_in_a_call_without_an_attempt() -> None:
    envelope = changed(changed(FAILURE, "meta/attempts", 0), "meta/source", "none")
    timeout = {**ERROR, "code": "timeout", "class": "transport", "outcome": "unknown"}
    assert found(result_of(changed(envelope, "error", timeout))) == [("outcome_without_attempt", "ERR-006")]
    assert found(result_of(changed(envelope, "error", {**timeout, "outcome": "not_sent"}))) == []


def test_the_words_of_a_schema_finding_name_the_member() -> None:
    missing = check_result(result_of(changed(FAILURE, "error/outcome", ...)))
    assert [finding.message for finding in missing] == ["error: 'outcome' is a required property"]
    wrong = check_result(result_of(changed(FAILURE, "error/retryable", "no")))
    assert [finding.message for finding in wrong] == ["error: retryable: 'no' is not of type 'boolean'"]


def test_an_adapter_that_reports_a_bug_of_its_own_is_found() -> None:
    error = {**ERROR, "code": "internal_error", "class": "internal", "outcome": "unknown"}
    assert found(result_of(changed(FAILURE, "error", error))) == [("internal_error", "ERR-001")]


@pytest.mark.parametrize("path", ["success", "data", "error", "meta", "meta/connection", "error/code"])
@pytest.mark.parametrize("value", [None, 0, "text", [], {}, True, ...])
def test_no_malformed_envelope_makes_the_kit_fail(path: str, value: Any) -> None:
    check_result(result_of(changed(FAILURE, path, value)), measured_latency_ms=2.0)
