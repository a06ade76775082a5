"""One exchange on the wire, read by the rules of the subject: what it says, and what is wrong with it as an exchange."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from pytest_otmcp.session.exchange import Exchange, joined, joint
from pytest_otmcp.subject.model import Answering, ErrorRule, OutcomeRule, OutputRule
from pytest_otmcp.trial.reply import Expectation, Reply, observe, replace_outputs

from .journals import entry

PROSE = Answering(form="text", errors=(ErrorRule(text="[Uu]nknown|0x02", code="illegal_address"),))
STRUCTURED = Answering(form="structured")


def observed(
    message: dict[str, Any] | bytes | None, answering: Answering = PROSE, *, listed: bool = True, **more: Any
) -> Reply:
    response = message if isinstance(message, bytes) or message is None else json.dumps(message).encode()
    exchange = Exchange(
        tool="write",
        arguments={"value": 5},
        request=b"{}",
        response=response,
        received_ns=None if response is None else more.pop("received_ns", 1_000_000),
        starved_ns=more.pop("starved_ns", 0),
        failure=more.pop("failure", None),
        client_complaint=more.pop("client_complaint", None),
    )
    expected = Expectation(
        adapter="modbus",
        variant="rw" if listed else "ro",
        operation=more.pop("operation", "write_holding"),
        deadline_s=1.0,
        answering=answering,
        outputs=more.pop("outputs", {}),
        calls=more.pop("calls", 1),
        listed=listed,
    )
    return observe(exchange, expected)


def result(text: str, *, is_error: bool = False, structured: Any = None) -> dict[str, Any]:
    body: dict[str, Any] = {"content": [{"type": "text", "text": text}], "isError": is_error}
    if structured is not None:
        body["structuredContent"] = structured
    return {"jsonrpc": "2.0", "id": 1, "result": body}


def codes(reply: Reply) -> list[str]:
    return [fault.code for fault in reply.faults]


UNKNOWN_TOOL = {"jsonrpc": "2.0", "id": 1, "error": {"code": -32602, "message": "Unknown tool: write"}}


@pytest.mark.parametrize("answering", [PROSE, STRUCTURED, Answering()], ids=["prose", "structured", "envelope"])
@pytest.mark.parametrize(
    "answer", [result("Unknown tool: write", is_error=True), UNKNOWN_TOOL], ids=["result", "error"]
)
def test_a_tool_that_the_read_only_session_does_not_list_is_a_guard(
    answer: dict[str, Any], answering: Answering
) -> None:
    reply = observed(answer, answering, listed=False)
    assert (reply.success, reply.error_code, codes(reply)) == (False, "writes_disabled", [])
    assert reply.native is False
    assert reply.listed is False


def test_a_tool_that_is_not_listed_and_works_nevertheless_is_no_guard() -> None:
    assert observed(result("Wrote 5"), listed=False).success is True


def test_a_listed_tool_that_is_unknown_when_it_is_called_is_no_guard() -> None:
    assert observed(result("Unknown tool: write", is_error=True)).error_code == "illegal_address"
    (fault,) = observed(UNKNOWN_TOOL, Answering()).faults
    assert (fault.code, fault.requirement) == ("json_rpc_error", "MCP-007")


def test_an_answer_of_its_own_becomes_an_envelope_that_says_so() -> None:
    reply = observed(result("exception 0x02", is_error=True))
    assert reply.envelope is not None
    assert reply.envelope["meta"]["synthesised"] is True
    assert reply.envelope["error"]["outcome"] == "unknown"
    assert reply.native is False


def test_what_an_operation_reads_cannot_have_been_applied() -> None:
    reply = observed(result("exception 0x02", is_error=True), operation="read_holding")
    assert reply.envelope is not None
    assert reply.envelope["error"]["outcome"] == "not_applicable"


def test_outputs_are_read_from_the_document_and_not_from_the_made_envelope() -> None:
    rule = OutputRule(path="data.value")
    reply = observed(result("", structured={"data": {"value": 5}}), STRUCTURED, outputs={"value": rule})
    assert reply.outputs == {"value": 5}


@pytest.mark.parametrize(
    "answer",
    [
        result("Wrote 5 (Demo Mode - No Modbus Connection)"),
        result("Wrote 5", structured={"result": "Wrote 5 (Demo Mode - No Modbus Connection)"}),
        result("", structured={"written": 5, "dry_run": True}),
    ],
    ids=["prose", "prose that the SDK wrapped", "a member"],
)
def test_a_success_that_admits_to_be_none_is_a_fault(answer: dict[str, Any]) -> None:
    answering = STRUCTURED if "structuredContent" in answer["result"] else PROSE
    (fault,) = observed(answer, answering).faults
    assert (fault.code, fault.requirement) == ("not_from_the_device", "RD-004")
    assert "claims success, but says itself that it is not the device's" in fault.message


def test_a_function_that_takes_a_dry_run_for_a_refusal_is_believed() -> None:
    echo = result("DRY RUN: would write 5")
    refused = replace_outputs(observed(echo), {}, ("writes_disabled", "DRY RUN: would write 5"))
    assert (refused.success, refused.error_code, codes(refused)) == (False, "writes_disabled", [])
    found = replace_outputs(observed(echo), {"value": 5}, None)
    assert (found.success, found.outputs, codes(found)) == (True, {"value": 5}, ["not_from_the_device"])


def test_what_a_function_made_of_no_answer_does_not_count() -> None:
    reply = observed(None, failure="timeout")
    assert replace_outputs(reply, {"value": 5}, None) is reply
    assert (reply.envelope, reply.outputs, codes(reply)) == (None, {}, ["no_reply"])


@pytest.mark.parametrize(
    "text",
    ['{"value": NaN}', '{"value": -Infinity}', '{"value": 1e999}', "[" * 100_000],
    ids=["NaN", "infinity", "beyond doubles", "deep"],
)
def test_a_text_that_only_python_takes_for_json_is_no_document(text: str) -> None:
    reply = observed(result(text), Answering(form="json"), outputs={"value": OutputRule(path="value")})
    assert reply.outputs == {"value": None}
    json.dumps([reply.envelope, reply.outputs], allow_nan=False)


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("nan", OutputRule(convert="float")),
        ("1e999", OutputRule(convert="float")),
        ("{1, 2}", OutputRule(convert="python")),
        ("b'x'", OutputRule(convert="python")),
        ("1e999", OutputRule(convert="python")),
        ("[NaN]", OutputRule(convert="json")),
    ],
)  # fmt: skip
def test_an_output_that_json_cannot_say_is_none(text: str, rule: OutputRule) -> None:
    assert observed(result(text), outputs={"value": rule}).outputs == {"value": None}


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (b'{"id":1,"result":{"content":[],"structuredContent":{"value":NaN}}}', "NaN is no JSON number"),
        (b'{"id":1,"result":{"content":[{"type":"text","text":"\xff"}]}}', "not UTF-8"),
        (b'{"id":1,"id":2}', "occurs twice"),
    ],
)
def test_a_frame_that_is_not_strict_json_is_the_adapters_fault_whatever_its_answers_look_like(
    frame: bytes, reason: str
) -> None:
    reply = observed(frame)
    assert codes(reply) == ["not_strict_json"]
    assert reason in reply.faults[0].message
    assert reply.envelope is None


def test_silence_and_a_lost_session_are_told_apart() -> None:
    assert codes(observed(None, failure="timeout")) == ["no_reply"]
    assert codes(observed(None, failure="connection_closed")) == ["session_lost"]


def test_an_answer_after_the_deadline_is_late_and_still_read() -> None:
    reply = observed(result("Wrote 5"), received_ns=1_200_000_000)
    assert codes(reply) == ["deadline_missed"]
    assert "answered after 1200 ms, deadline 1 s" in reply.faults[0].message
    assert reply.success is True


def test_the_time_without_a_processor_is_no_part_of_a_late_answer() -> None:
    late_ns = 1_200_000_000
    excused = observed(result("Wrote 5"), received_ns=late_ns, starved_ns=200_000_000)
    assert (codes(excused), excused.exchange.starved_ns) == ([], 200_000_000)
    assert codes(observed(result("Wrote 5"), received_ns=late_ns, starved_ns=199_000_000)) == ["deadline_missed"]


def test_of_an_answer_in_time_nothing_is_kept_that_would_excuse_it() -> None:
    assert observed(result("Wrote 5"), received_ns=900_000_000, starved_ns=500_000_000).exchange.starved_ns == 0


def test_each_of_several_calls_has_the_deadline() -> None:
    parts = [Exchange(tool="poll", arguments={}, sent_ns=at, received_ns=at + 900_000_000) for at in (0, 10**9)]
    calls = joint(joined(parts, {}).tool)
    assert codes(observed(result("Wrote 5"), received_ns=1_900_000_000, calls=calls)) == []
    assert codes(observed(result("Wrote 5"), received_ns=2_100_000_000, calls=calls)) == ["deadline_missed"]


def test_what_the_official_client_rejects_is_told_of_a_result_only() -> None:
    assert codes(observed(result("x"), client_complaint="no such member")) == ["client_rejects"]
    assert codes(observed(UNKNOWN_TOOL, client_complaint="Unknown tool: write")) == []


ODD = [None, 0, 1.5, True, "", "x", "{}", [], [None], ["a"], [[]], {}, {"type": "text"}, [{"type": "text", "text": 5}]]
ODD += [{"result": 5}, {"errors": 7}, {"success": "no"}, {"error": "boom"}, {"source": {"a": 1}}, {"demo": [True]}]


@pytest.mark.parametrize("form", ["envelope", "structured", "json", "text", "texts"])
@pytest.mark.parametrize("listed", [True, False])
def test_no_answer_is_odd_enough_to_break_the_kit(form: str, listed: bool) -> None:
    rules = {
        "a": OutputRule(path="a"),
        "b": OutputRule(path="errors", split=",", convert="int"),
        "c": OutputRule(regex="x", convert="hex"),
        "d": OutputRule(path="[].a", then="length(@)"),
        "e": OutputRule(path="result", convert="bool", wrap=True),
        "f": OutputRule(strip="x", convert="string"),
    }
    rest = {} if form == "envelope" else {"outcome": (OutcomeRule(success=False, path="length(errors) > `0`"),)}
    answering = Answering(form=form, **rest)
    bodies = [{name: odd} for odd in ODD for name in ("content", "contents", "structuredContent", "isError")]
    messages = [{"id": 1, kind: odd} for odd in (*ODD, *bodies) for kind in ("result", "error")]
    for message in messages:
        reply = observed(message, answering, listed=listed, outputs=rules)
        assert reply.success in (True, False, None)
        json.dumps([reply.envelope, reply.outputs], allow_nan=False)


@pytest.mark.parametrize(("connected", "success"), [(True, True), (False, False)])
def test_a_status_that_says_that_there_is_no_connection_is_no_success(connected: bool, success: bool) -> None:
    reply = observed(
        result(json.dumps({"alive": connected})),
        Answering(form="json"),
        operation="ping",
        outputs={"reachable": OutputRule(path="alive")},
    )
    assert reply.success is success
    assert reply.outputs == {"reachable": connected}
    assert reply.error_code == (None if success else "connect_failed")


def test_what_happened_during_a_call_is_told_from_what_came_before_and_after() -> None:
    reply = observed(result("done"), received_ns=20)
    entries = [entry("read", t_ns=moment) for moment in (-1, 0, 10, 20, 21)]
    assert [seen["t_ns"] for seen in reply.during(entries)] == [0, 10, 20]
    assert observed(None, failure="timeout").during(entries) == []


@pytest.mark.parametrize("data", [None, [], [{"partial": 1}], "partial", 7, {}, {"partial": None}])
def test_a_member_that_is_not_there_is_none_whatever_is_in_its_place(data: object) -> None:
    reply = observed({"jsonrpc": "2.0", "id": 1, "result": {"structuredContent": {"data": data}}}, STRUCTURED)
    strange = replace(reply, envelope={"data": data})
    assert strange.member("data", "partial") is None
    assert replace(reply, envelope={"data": {"partial": [7]}}).member("data", "partial") == [7]
    assert replace(reply, envelope=None).member("data", "partial") is None


@pytest.mark.parametrize(
    ("text", "wordless"),
    [
        ("", True),
        ("Error calling tool 'receive_message': ", True),
        ("Error executing tool read_register:", True),
        ("Error: ", True),
        ("Failed", True),
        ("Error calling tool 'receive_message': timed out", False),
        ("Error: no", False),
        ("timeout", False),
        ("Failed to connect", False),
        ("Error 2", False),
    ],
)
def test_a_failure_without_a_word_of_what_is_wrong_is_warned_of(text: str, wordless: bool) -> None:
    reply = observed(result(text, is_error=True))
    found = [(fault.code, fault.requirement, fault.is_must) for fault in reply.faults]
    assert found == ([("wordless_error", "ENV-006", False)] if wordless else [])
    assert reply.success is False


def test_a_failure_whose_words_are_in_its_document_has_words() -> None:
    told = result("", is_error=True, structured={"error": "no such register"})
    assert codes(observed(told, STRUCTURED)) == codes(observed(told)) == []
