"""What is said of a call: facts of both sides, and a contradiction only where there is one."""

from __future__ import annotations

import json

import pytest

from pytest_otmcp.console.reading import Claim, Seen, claim, compared
from pytest_otmcp.protocols.journal import JournalEntry
from pytest_otmcp.session.exchange import Exchange
from pytest_otmcp.subject import reference_subject

SUBJECT = reference_subject()
MODBUS, MQTT = SUBJECT.adapters["modbus"], SUBJECT.adapters["mqtt"]
SUCCESS, FAILURE = Claim(success=True, words="success"), Claim(success=False, words="failure: connect_failed")


def entry(seq: int, function: int, *, changing: bool = False, **more: object) -> JournalEntry:
    """Return a request, or with ``answers`` a response, of a Modbus device's journal."""
    answers = more.pop("answers", None)
    told = {
        "seq": seq,
        "t_ns": seq,
        "connection": 1,
        "direction": "in" if answers is None else "out",
        "kind": "request" if answers is None else "response",
        "origin": "client",
        "request": answers is None,
        "state_changing": changing,
        "answers": answers,
        "function": function,
        **more,
    }
    return told  # type: ignore[return-value]


READ, WRITE = entry(0, 3), entry(0, 6, changing=True)
DONE, REFUSED = entry(1, 6, answers=0, exception=None), entry(1, 6, answers=0, exception=2)
STOPPED = Seen(stopped=True, paused=False, entries=[])
PAUSED = Seen(stopped=False, paused=True, entries=[])


def seen(*entries: JournalEntry) -> Seen:
    return Seen(stopped=False, paused=False, entries=entries)


@pytest.mark.parametrize(
    ("tool", "claimed", "device", "contradicts"),
    [
        ("write_register", SUCCESS, seen(WRITE, DONE), False),
        ("write_register", SUCCESS, seen(), True),
        ("write_register", SUCCESS, seen(READ), True),
        ("write_register", SUCCESS, STOPPED, True),
        ("write_register", SUCCESS, PAUSED, True),
        ("write_register", FAILURE, STOPPED, False),
        ("write_register", FAILURE, seen(), False),
        ("write_register", FAILURE, seen(WRITE, REFUSED), False),
        ("write_register", FAILURE, seen(WRITE, DONE), True),
        # The device did it and its answer was lost: the adapter cannot know.
        ("write_register", FAILURE, seen(WRITE), False),
        ("write_register", Claim(success=None, words="no reply (timeout)"), seen(WRITE, DONE), False),
        ("read_multiple_holding_registers", SUCCESS, seen(READ), False),
        ("read_multiple_holding_registers", SUCCESS, STOPPED, True),
        # An adapter may read by itself all the time and answer what it has just read.
        ("read_multiple_holding_registers", SUCCESS, seen(), False),
        # A status says truthfully that nobody is there.
        ("ping", SUCCESS, STOPPED, False),
        ("a tool that is not bound", SUCCESS, STOPPED, False),
        ("a tool that is not bound", SUCCESS, seen(), False),
    ],
)
def test_a_contradiction_is_one(tool: str, claimed: Claim, device: Seen, contradicts: bool) -> None:
    assert compared(MODBUS, tool, claimed, device)[1] is contradicts


def tool_of(operation: str) -> str:
    """Return the tool of the MQTT adapter that is bound to an operation."""
    bindings = MQTT.operations[operation]
    assert isinstance(bindings, tuple)
    return bindings[0].tool


def test_a_message_is_on_its_way_to_a_broker_that_is_paused_and_lost_at_one_that_is_gone() -> None:
    assert not compared(MQTT, tool_of("publish"), SUCCESS, PAUSED)[1]
    assert compared(MQTT, tool_of("publish"), SUCCESS, STOPPED)[1]


def test_messages_that_came_before_are_read_without_the_broker() -> None:
    assert not compared(MQTT, tool_of("messages"), SUCCESS, STOPPED)[1]


@pytest.mark.parametrize(
    ("claimed", "device", "sentence"),
    [
        (SUCCESS, seen(WRITE, DONE), "The adapter claims success. The device saw 1 request, which asks for a change."),
        (SUCCESS, seen(READ), "The adapter claims success. The device saw 1 request, which asks for no change."),
        (
            SUCCESS,
            seen(READ, WRITE),
            "The adapter claims success. The device saw 2 requests, of which 1 asks for a change.",
        ),
        (
            SUCCESS,
            seen(WRITE, WRITE),
            "The adapter claims success. The device saw 2 requests, of which 2 ask for a change.",
        ),
        (
            SUCCESS,
            seen(READ, READ),
            "The adapter claims success. The device saw 2 requests, of which none asks for a change.",
        ),
        (SUCCESS, PAUSED, "The adapter claims success. The device is paused and has read nothing."),
        (FAILURE, STOPPED, "The adapter claims failure: connect_failed. The device is stopped and saw nothing."),
        (
            Claim(success=None, words="no reply (timeout)"),
            seen(),
            "There is no reply (timeout). The device saw no request.",
        ),
    ],
)
def test_both_sides_are_said_in_a_sentence_each(claimed: Claim, device: Seen, sentence: str) -> None:
    assert compared(MODBUS, "write_register", claimed, device)[0] == sentence


def reply(tool: str = "write_register", **message: object) -> Exchange:
    return Exchange(tool=tool, arguments={}, response=json.dumps({"jsonrpc": "2.0", "id": 1, **message}).encode())


def result(structured: object = None, text: str = "", is_error: bool = False) -> dict[str, object]:
    return {
        "structuredContent": structured,
        "content": [{"type": "text", "text": text}],
        "isError": is_error,
    }


@pytest.mark.parametrize(
    ("exchange", "success", "words"),
    [
        (reply(result=result({"success": True})), True, "success"),
        (reply(result=result({"success": False, "error": {"code": "timeout"}})), False, "failure: timeout"),
        (reply(result=result({"success": False, "error": "x"})), False, "failure: None"),
        (reply(result=result({"success": "yes"})), True, "success, without an envelope"),
        (reply(result=result(None, "no", is_error=True)), False, "failure, without an envelope"),
        (reply(error={"code": -32602, "message": "no such tool"}), False, "failure: a JSON-RPC error"),
        (Exchange(tool="x", arguments={}, failure="connection_closed"), None, "no reply (connection closed)"),
        (Exchange(tool="x", arguments={}, response=b"[]"), None, "a response that is no JSON object"),
    ],
)
def test_a_claim_is_read_by_the_rules_of_the_subject(exchange: Exchange, success: bool | None, words: str) -> None:
    found = claim(exchange, MODBUS)
    assert (found.success, found.words) == (success, words)


def test_a_response_that_two_readers_read_differently_claims_nothing() -> None:
    twice = b'{"result": {"structuredContent": {"success": true, "success": false}}}'
    found = claim(Exchange(tool="x", arguments={}, response=twice), MODBUS)
    assert found.success is None
    assert found.words == "a response that is not strict JSON: the member 'success' occurs twice"
