"""Replies judged against expectations: of an adapter with envelopes, and of one whose envelopes the kit makes."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
from pytest_otmcp.conformance.tasks.messages import received

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.core.finding_registry import finding_codes
from pytest_otmcp.session.exchange import Exchange
from pytest_otmcp.trial.expectations import failed, succeeded
from pytest_otmcp.trial.reply import Reply

SILENCE = Exchange(tool="write", arguments={"address": 1}, request=b"{}", failure="timeout")


def reply(envelope: dict[str, Any] | None, *, native: bool = True, **outputs: Any) -> Reply:
    answered = replace(SILENCE, response=json.dumps(envelope).encode(), received_ns=1, failure=None)
    return Reply(
        adapter="modbus",
        variant="rw",
        operation="write_holding",
        exchange=SILENCE if envelope is None else answered,
        envelope=envelope,
        outputs=outputs,
        native=native,
    )


def success(**outputs: Any) -> Reply:
    return reply({"success": True, "data": {}, "error": None, "meta": {}}, **outputs)


def refusal(code: str | None, *, native: bool = True, outcome: str = "not_sent", **trace: Any) -> Reply:
    error = {"code": code, "message": "no", "outcome": outcome}
    return reply({"success": False, "data": None, "error": error, "meta": {"trace": trace}}, native=native)


def said(findings: list[Finding]) -> list[tuple[str, str | None]]:
    return [(finding.code, finding.requirement) for finding in findings]


# -- success ------------------------------------------------------------------------------------------------------------


def test_a_success_with_the_expected_outputs_is_one() -> None:
    assert succeeded(success(value=41, address=1), value=41) == []


@pytest.mark.parametrize("value", [40, 41.5, "41", True, None, [41]])
def test_another_value_or_another_type_is_told(value: Any) -> None:
    (finding,) = succeeded(success(value=value), value=41)
    assert (finding.code, finding.requirement) == ("wrong_value", "WR-001")
    assert f"value should be 41, the reply says {json.dumps(value)}" in finding.message


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ([*range(125)], "values should be a list of 126, the reply says a list of 125"),
        ([*range(125), 0], "values, element 125 of 126, should be 125, the reply says 0"),
        (["0", *range(1, 125), 0], 'values, element 0 of 126, should be 0, the reply says "0"'),
    ],
)
def test_two_long_lists_are_told_apart(found: list[Any], words: str) -> None:
    (finding,) = succeeded(success(values=found), values=[*range(126)])
    assert words in finding.message


@pytest.mark.parametrize("words", ["Runaway guard tripped: 25 equal calls", "rate-limit reached", "Too many requests"])
def test_a_limit_of_the_adapters_own_is_named_and_breaks_no_rule_of_the_call(words: str) -> None:
    error = {"code": "unclassified", "message": words}
    (finding,) = succeeded(reply({"success": False, "error": error}, native=False), requirement="ENC-003")
    assert (finding.code, finding.requirement) == ("own_limit", None)
    assert words in finding.message
    assert finding_codes()[finding.code].keys == ("call_limit",)


def test_a_limit_that_the_launch_was_told_or_that_is_the_devices_is_none_of_these() -> None:
    limited = refusal("rate_limited")
    assert said(succeeded(limited)) == [("own_limit", None)]
    assert said(succeeded(replace(limited, variant="bounded"), requirement="WR-007")) == [("not_successful", "WR-007")]
    assert said(succeeded(refusal("rate_limited", outcome="rejected"))) == [("not_successful", "WR-001")]
    assert said(succeeded(refusal("device_busy"))) == [("not_successful", "WR-001")]


def test_an_output_that_the_subject_does_not_say_where_to_find_is_not_judged() -> None:
    assert succeeded(success(), value=41) == []


def test_a_failure_is_no_success_whatever_its_outputs() -> None:
    (finding,) = succeeded(refusal("timeout"), value=41)
    assert said([finding]) == [("not_successful", "WR-001")]
    assert "write(address=1): expected success, got error 'timeout': no" in finding.message


@pytest.mark.parametrize(
    ("envelope", "words"),
    [(None, "got no reply"), ({"success": "yes"}, "got no success"), ({"data": 1}, "got no success")],
    ids=["silence", "a word", "nothing"],
)
def test_what_does_not_claim_success_in_so_many_words_is_none(envelope: dict[str, Any] | None, words: str) -> None:
    (finding,) = succeeded(reply(envelope))
    assert finding.message.endswith(words)


# -- failure ------------------------------------------------------------------------------------------------------------


def test_a_refusal_with_one_of_the_codes_is_one() -> None:
    assert failed(refusal("timeout"), "connect_failed", "timeout") == []


@pytest.mark.parametrize("native", [True, False])
def test_a_success_is_no_refusal(native: bool) -> None:
    claimed = reply({"success": True, "data": {}, "error": None, "meta": {}}, native=native)
    (finding,) = failed(claimed, "range_overflow")
    assert said([finding]) == [("not_refused", "ERR-001")]
    assert finding.message.endswith("with code range_overflow, it claims success")


def test_silence_is_no_refusal() -> None:
    (finding,) = failed(reply(None), "timeout")
    assert finding.message.endswith("got no reply")


@pytest.mark.parametrize("native", [True, False])
def test_a_wrong_code_is_wrong_whoever_found_it(native: bool) -> None:
    (finding,) = failed(refusal("timeout", native=native), "illegal_address")
    assert said([finding]) == [("wrong_error_code", "ERR-001")]
    assert "error code should be illegal_address, it is 'timeout'" in finding.message


def test_a_failure_that_the_subject_file_does_not_classify_is_legal_where_it_was_made_for_the_adapter() -> None:
    assert failed(refusal("unclassified", native=False), "illegal_address") == []


def test_a_code_that_no_registry_has_is_not_reported_twice() -> None:
    assert failed(refusal("unclassified"), "illegal_address") == []


def test_a_step_says_which_requirement_a_claim_of_success_and_another_code_break() -> None:
    (finding,) = failed(success(), "range_overflow", requirement="ADR-003")
    assert finding.requirement == "ADR-003"
    broken = failed(refusal("timeout"), "connect_failed", requirement="WR-001", code_requirement="REC-002")
    assert said(broken) == [("wrong_error_code", "REC-002")]
    (finding,) = succeeded(refusal("timeout"), requirement="REC-001")
    assert finding.requirement == "REC-001"


@pytest.mark.parametrize(
    ("expected", "found", "requirement"),
    [
        (1.23456, 1.23, "ENC-003"),
        ([1.5, 2.71828], [1.5, 2.72], "ENC-003"),
        (1.23456, 1.24, "WR-001"),
        ([1.23456], [1.23, 2.0], "WR-001"),
        (2.5, 3.0, "WR-001"),
    ],
)
def test_a_value_with_fewer_decimals_was_rounded(expected: object, found: object, requirement: str) -> None:
    (finding,) = succeeded(success(value=found), value=expected)
    assert finding.requirement == requirement


def test_the_outcome_must_be_one_of_those_that_can_be() -> None:
    assert failed(refusal("type_mismatch", outcome="rejected"), "type_mismatch", outcome=("not_sent", "rejected")) == []
    (finding,) = failed(refusal("type_mismatch", outcome="unknown"), "type_mismatch", outcome="not_sent")
    assert said([finding]) == [("wrong_outcome", "ERR-006")]


def test_the_trace_must_hold_what_is_asked_for_and_may_hold_more() -> None:
    asked = {"status_code": {"symbol": "BadNodeIdUnknown"}}
    found = refusal("x", status_code={"symbol": "BadNodeIdUnknown", "value": 1}, other=2)
    assert failed(found, "x", trace=asked) == []
    assert said(failed(refusal("x", status_code="BadNodeIdUnknown"), "x", trace=asked)) == [("wrong_trace", "ENV-007")]
    assert said(failed(refusal("x"), "x", trace={"exception_code": 2})) == [("wrong_trace", "ENV-007")]


def test_of_an_adapter_without_envelopes_neither_outcome_nor_trace_is_asked_for() -> None:
    made = refusal("range_overflow", native=False, outcome="unknown")
    assert failed(made, "range_overflow", outcome="not_sent", trace={"exception_code": 2}) == []


@pytest.mark.parametrize(
    ("envelope", "codes"),
    [
        ({"success": False, "error": "timeout"}, ["wrong_trace"]),
        ({"success": False, "error": ["timeout"], "meta": 5}, ["wrong_trace"]),
        (
            {"success": False, "error": {"code": 7, "outcome": {}}, "meta": {"trace": "none"}},
            ["wrong_outcome", "wrong_trace"],
        ),
        ({"success": False}, ["wrong_trace"]),
    ],
    ids=["a word", "a list", "other types", "nothing"],
)
def test_what_was_reported_of_an_envelope_is_not_reported_again(envelope: dict[str, Any], codes: list[str]) -> None:
    findings = failed(reply(envelope), "timeout", outcome="not_sent", trace={"exception_code": 2})
    assert [finding.code for finding in findings] == codes


# -- messages -----------------------------------------------------------------------------------------------------------

MINE = {"topic": "a/b", "payload": "nonce"}
OTHER = {"topic": "a/c", "payload": "another"}


@pytest.mark.parametrize(
    ("messages", "filtered"),
    [([MINE], True), ([MINE], False), ([OTHER, MINE, OTHER], False), ([MINE | {"qos": 0}], True)],
    ids=["alone", "alone, unfiltered", "among others, unfiltered", "with more members"],
)
def test_a_message_that_is_there_once_was_received(messages: list[Any], filtered: bool) -> None:
    assert received(success(messages=messages), "a/b", "nonce", filtered=filtered) == []


@pytest.mark.parametrize(
    ("messages", "filtered"),
    [
        ([], True),
        (None, True),
        ("nonce", False),
        (["nonce"], False),
        ([MINE, MINE], False),
        ([MINE, OTHER], True),
        ([{"topic": "a/c", "payload": "nonce"}], False),
        ([{"topic": ["a/b"], "payload": "nonce"}], False),
        ([MINE, "another"], True),
        ([OTHER], False),
    ],
    ids=[
        "none",
        "nothing",
        "no list",
        "no objects",
        "twice",
        "one that was not asked for",
        "another topic",
        "a topic that is no text",
        "one that is no object",
        "another",
    ],
)
def test_a_message_that_is_not_there_once_and_alone_is_told(messages: Any, filtered: bool) -> None:
    (finding,) = received(success(messages=messages), "a/b", "nonce", filtered=filtered)
    assert said([finding]) == [("wrong_value", "MQT-004")]
    assert ("and nothing else" in finding.message) is filtered


def test_a_failure_to_look_is_told_as_such() -> None:
    assert said(received(refusal("timeout"), "a/b", "nonce", filtered=True)) == [("not_successful", "WR-001")]
