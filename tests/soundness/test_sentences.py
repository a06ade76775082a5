"""The judge of sentences itself: it finds each kind of sentence that the record of its item contradicts."""

from __future__ import annotations

from typing import Any

import pytest

from .sentences import untrue

REFUSED = {"code": "invalid_input", "message": "no", "outcome": "not_sent"}


def call(error: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    envelope = {"success": error is None, "data": {"value": 41}, "error": error, "meta": {}}
    return {
        "tool": "write_register",
        "arguments": {"address": 1},
        "envelope": envelope,
        "outputs": {"value": 41},
        "error_code": None if error is None else error["code"],
        "received_ns": 1,
        **more,
    }


SUCCESS, FAILURE = call(), call(REFUSED)
SILENCE = call(envelope=None, received_ns=None)
CANCELLED = {**SILENCE, "frames": {"failure": "cancelled", "response": None}}
LABEL = "write_register(address=1): "


def item(
    message: str, *calls: dict[str, Any], code: str = "not_refused", requirement: str = "WR-001"
) -> dict[str, Any]:
    finding = {"code": code, "message": message, "requirement": requirement}
    return {"id": "M1", "around": [], "findings": [], "samples": [{"calls": list(calls), "findings": [finding]}]}


@pytest.mark.parametrize(
    ("message", "true", "false"),
    [
        (f"{LABEL}it should have failed, it claims success", SUCCESS, FAILURE),
        ("modbus: a read succeeded after the device was started, which saw no connection", SUCCESS, FAILURE),
        (f"{LABEL}it was reported as failed, and the device saw a write after that", FAILURE, CANCELLED),
        (f"{LABEL}it was reported as failed, and the device saw a write after that", FAILURE, SUCCESS),
        (f"{LABEL}expected success, got error 'invalid_input': no", FAILURE, SUCCESS),
        (f"{LABEL}expected success, got no reply", SILENCE, FAILURE),
        (f"{LABEL}no reply within the deadline of 5 s", SILENCE, SUCCESS),
        (f"{LABEL}it was never answered, and the device saw a write after that", SILENCE, CANCELLED),
        (f"{LABEL}the kit cancelled the call, and the device saw a write after that", CANCELLED, SILENCE),
        (
            f"{LABEL}it says that nothing was sent, the device saw a write",
            FAILURE,
            call({**REFUSED, "outcome": "unknown"}),
        ),
        (f"{LABEL}error code should be timeout, it is 'invalid_input'", FAILURE, call({**REFUSED, "code": "timeout"})),
        (f"{LABEL}error outcome should be unknown, it is 'not_sent'", FAILURE, call({**REFUSED, "outcome": "unknown"})),
        (
            f"{LABEL}value should be 40, the reply says 41",
            SUCCESS,
            call(outputs={"value": 7}, envelope={"success": True}),
        ),
    ],
)
def test_a_sentence_is_held_against_the_reply_that_it_is_about(
    message: str, true: dict[str, Any], false: dict[str, Any]
) -> None:
    assert untrue([item(message, true)]) == []
    assert untrue([item(message, false)]) == [f"M1: {message}"]
    # The reply of another call does not make it true, where the sentence names one.
    if message.startswith(LABEL):
        other = {**true, "arguments": {"address": 2}}
        assert untrue([item(message, other, false)]) == [f"M1: {message}"]


@pytest.mark.parametrize("reply", [SUCCESS, SILENCE, call({**REFUSED, "outcome": "unknown"})])
def test_what_arrived_is_about_a_reply_that_said_that_nothing_was_sent_or_not_about_that_rule(
    reply: dict[str, Any],
) -> None:
    message = "modbus: the device should have seen no state-changing request, it saw 1"
    assert untrue([item(message, FAILURE, code="wrote", requirement="ERR-006")]) == []
    assert untrue([item(message, reply, code="wrote", requirement="ERR-006")]) == [f"M1: {message}"]
    assert untrue([item(message, reply, code="wrote", requirement="WR-004")]) == []


def test_a_sentence_about_a_reply_that_no_rule_knows_is_untrue_until_there_is_one() -> None:
    message = f"{LABEL}it said something else altogether"
    assert untrue([item(message, SUCCESS)]) == [f"M1: {message}"]


def test_a_finding_of_the_item_is_held_against_all_its_calls() -> None:
    message = f"warmup: {LABEL}it should have failed, it claims success"
    found = {"code": "not_refused", "message": message, "requirement": "WR-001"}
    entry = {**item("the device should have seen one write", FAILURE), "findings": [found]}
    assert untrue([entry]) == [f"M1: {message}"]
    assert untrue([{**entry, "around": [{"calls": [SUCCESS]}]}]) == []
