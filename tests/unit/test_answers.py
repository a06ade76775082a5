"""Answers in the shapes that adapters in the wild really give, read by a subject file's rules."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import pytest

from pytest_otmcp.subject.answers import UNCLASSIFIED, extract, interpret, read_answer, synthesised
from pytest_otmcp.subject.model import Answering, Binding, ErrorRule, OutcomeRule, OutputRule


def result(*texts: str, structured: Any = None, is_error: bool | None = None) -> dict[str, Any]:
    body: dict[str, Any] = {"content": [{"type": "text", "text": text} for text in texts]}
    if structured is not None:
        body["structuredContent"] = structured
    if is_error is not None:
        body["isError"] = is_error
    return {"jsonrpc": "2.0", "id": 1, "result": body}


def output(message: Mapping[str, Any], form: str, rule: OutputRule) -> Any:
    return extract({"x": rule}, read_answer(message, form)[0])["x"]


@pytest.mark.parametrize(
    ("message", "form", "rule", "expected"),
    [
        (result("110"), "text", OutputRule(convert="int", wrap=True), [110]),
        (result("True,False"), "text", OutputRule(split=",", convert="bool"), [True, False]),
        (
            result("Registers 0 to 3: [7, 8, 9, 10]"),
            "text",
            OutputRule(regex=r"\[.*\]", convert="json"),
            [7, 8, 9, 10],
        ),
        (result("Value: {'a': True}"), "text", OutputRule(regex=r"\{.*\}", convert="python", then="a"), True),
        (result("Value is 25.5 bar"), "text", OutputRule(regex=r"is ([\d.]+)", convert="float"), 25.5),
        (result('{"registers": [1, 2]}'), "json", OutputRule(path="registers"), [1, 2]),
        (result('{"n": 1}', '{"n": 2}'), "texts", OutputRule(path="[].n"), [1, 2]),
        (
            result("30", structured={"result": {"value": 30.0}}),
            "structured",
            OutputRule(path="result.value"),
            30.0,
        ),
        (
            result(structured={"result": '{"data": {"v": [5]}}'}),
            "structured",
            OutputRule(path="result", convert="json", then="data.v"),
            [5],
        ),
        (result("002a"), "text", OutputRule(convert="hex"), 42),
        (result("002aff"), "text", OutputRule(convert="bytes"), [0, 42, 255]),
        (result("002a0"), "text", OutputRule(convert="bytes"), None),
        (result('["2:Valve", "2:Pump"]'), "json", OutputRule(strip="2:"), ["Valve", "Pump"]),
        (result("nothing here"), "text", OutputRule(regex=r"value=(\d+)"), None),
        (result("not a number"), "text", OutputRule(convert="int"), None),
        (result("1.5"), "text", OutputRule(convert="int"), None),
        (result("no JSON"), "json", OutputRule(path="a"), None),
    ],
    ids=[
        "bare text", "comma list", "sentence", "python literal", "number in a sentence", "json in text",
        "a json per block", "structured", "json in json", "hex", "bytes", "half a byte", "browse names", "absent", "no number", "no whole number",
        "no json",
    ],
)  # fmt: skip
def test_an_output_is_found_where_its_rule_says(
    message: Mapping[str, Any], form: str, rule: OutputRule, expected: Any
) -> None:
    found = output(message, form, rule)
    assert found == expected
    assert json.dumps(found) == json.dumps(expected)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("25.0", 25.0), ("-7", -7), ("9007199254740991", 9007199254740991), ("9007199254740993", "9007199254740993"),
        ("[-9007199254740992]", ["-9007199254740992"]), ("1e+16", 1e16), ("true", True), ("False", False),
        ("None", None), ("null", None), ("[1, -2]", [1, -2]), ("['a', True]", ["a", True]), ('{"a": 1}', {"a": 1}),
        (" 7\n", 7), ("tank empty", "tank empty"), (" tank ", " tank "), ("2026-11-22 12:00:00", "2026-11-22 12:00:00"),
        ("NaN", "NaN"), ("nan", "nan"), ("0x10", "0x10"), ("1_000", "1_000"), ("1, 2", "1, 2"), ("{1, 2}", "{1, 2}"), ("", ""),
        ("[" * 100_000, "[" * 100_000), ("b'a'", "b'a'"),
    ],
)  # fmt: skip
def test_a_literal_is_its_value_and_every_other_text_is_itself(text: str, expected: Any) -> None:
    found = output(result(text), "text", OutputRule(convert="literal"))
    assert found == expected
    assert type(found) is type(expected)


def test_a_literal_in_a_list_is_read_and_what_is_no_text_stays() -> None:
    rule = OutputRule(path="values", convert="literal")
    assert output(result(structured={"values": ["1", "a", 2.5, None]}), "structured", rule) == [1, "a", 2.5, None]


def bound(rule: OutputRule, **members: Any) -> Binding:
    plain: dict[str, Any] = {"when": {}, "offset": {}, "names": {}, "convert": {}}
    return Binding(tool="t", arguments={}, outputs={"x": rule}, answering=Answering(), **{**plain, **members})


@pytest.mark.parametrize(
    ("path", "members", "inputs", "expected"),
    [
        ('values."$node"', {}, {"node": 'a"b;s=T'}, 1),
        ('values."$node"', {"names": {"node": {"a": "b"}}}, {"node": "a"}, 3),
        ('values."$address"', {"offset": {"address": 40001}}, {"address": 9}, 4),
        ('values."$nodes"', {}, {"nodes": ["b", 'a"b;s=T', "no"]}, [3, 1, None]),
        ('deep."$nodes"[].value', {}, {"nodes": ["b", "a"]}, [6, 5]),
        ('"$type"', {}, {"node": "a"}, "x"),
        ('values."$node"', {}, {"node": "missing"}, None),
    ],
    ids=["quoted", "a vendor's name", "an offset", "a list", "deep", "no input", "not there"],
)
def test_a_member_that_is_called_like_an_input_is_found(
    path: str, members: dict[str, Any], inputs: dict[str, Any], expected: Any
) -> None:
    document = {
        "values": {'a"b;s=T': 1, "a": 2, "b": 3, "40010": 4},
        "deep": {"a": {"value": 5}, "b": {"value": 6}},
        "$type": "x",
    }
    rules = bound(OutputRule(path=path), **members).outputs_for(inputs)
    assert extract(rules, document) == {"x": expected}


FAILED_TEXT = Answering(form="text", outcome=(OutcomeRule(success=False, text="^(Error|Failed)"),))


def test_without_a_rule_is_error_decides() -> None:
    assert interpret(result("Failed to write"), Answering(form="text")).success
    assert not interpret(result("ok", is_error=True), Answering(form="text")).success


def test_prose_that_begins_with_failed_is_a_failure() -> None:
    answer = interpret(result("Failed to write", is_error=False), FAILED_TEXT)
    assert (answer.success, answer.code, answer.text) == (False, UNCLASSIFIED, "Failed to write")
    assert interpret(result("Wrote 5; Failed attempts: 0"), FAILED_TEXT).success


def test_the_first_rule_that_matches_decides() -> None:
    rules = Answering(
        form="json",
        outcome=(
            OutcomeRule(success=True, path="status == 'warning'"),
            OutcomeRule(success=False, path="length(errors) > `0`"),
        ),
    )
    assert interpret(result('{"status": "warning", "errors": ["x"]}'), rules).success
    assert not interpret(result('{"status": "ok", "errors": ["x"]}'), rules).success
    assert interpret(result('{"status": "ok", "errors": []}'), rules).success


def test_all_conditions_of_a_rule_must_hold() -> None:
    rules = Answering(form="text", outcome=(OutcomeRule(success=True, is_error=True, text="already"),))
    assert interpret(result("already connected", is_error=True), rules).success
    assert not interpret(result("no route", is_error=True), rules).success


def test_a_rule_about_another_shape_does_not_match() -> None:
    rules = Answering(form="json", outcome=(OutcomeRule(success=False, path="length(errors) > `0`"),))
    assert interpret(result('{"errors": 7}'), rules).success


def test_a_failure_has_the_code_of_the_first_rule_that_knows_it() -> None:
    rules = Answering(
        form="text",
        errors=(ErrorRule(text="0x02", code="illegal_address"), ErrorRule(text="exception", code="device_failure")),
    )
    assert interpret(result("exception 0x02", is_error=True), rules).code == "illegal_address"
    assert interpret(result("exception 0x04", is_error=True), rules).code == "device_failure"
    assert interpret(result("", is_error=True), rules).code == UNCLASSIFIED


def test_a_json_rpc_error_is_a_failure_whatever_the_rules_say() -> None:
    always = Answering(form="text", outcome=(OutcomeRule(success=True, text=".*"),))
    answer = interpret({"id": 1, "error": {"code": -32602, "message": "Unknown tool: x"}}, always)
    assert (answer.success, answer.text) == (False, "Unknown tool: x")


@pytest.mark.parametrize(
    ("message", "form"),
    [
        (result("Wrote 70000 (Demo Mode - No Modbus Connection)"), "text"),
        (result("DRY RUN: would write 5"), "text"),
        (result('{"ok": true, "dry_run": true}'), "json"),
        (result(structured={"data": {"value": 5, "source": "cache"}}), "structured"),
        (result(structured={"values": [{"simulated": True}]}), "structured"),
    ],
    ids=["demo", "dry run in words", "dry run", "cache", "simulated"],
)
def test_a_success_that_admits_not_to_be_the_devices_is_told(message: Mapping[str, Any], form: str) -> None:
    assert interpret(message, Answering(form=form)).admission


@pytest.mark.parametrize(
    ("message", "form"),
    [
        (result('{"ok": true, "dry_run": false, "source": "device"}'), "json"),
        (result('{"messages": [{"topic": "demo mode", "payload": "dry run"}]}'), "json"),
        (result("Wrote 5 to the demonstrator"), "text"),
    ],
    ids=["not a dry run", "a payload", "another word"],
)
def test_what_only_looks_like_an_admission_is_none(message: Mapping[str, Any], form: str) -> None:
    assert interpret(message, Answering(form=form)).admission is None


def test_an_envelope_is_made_and_says_that_it_is() -> None:
    failed = interpret(
        result("0x02", is_error=True), Answering(form="text", errors=(ErrorRule(text="0x02", code="illegal_address"),))
    )
    envelope = synthesised(failed, protocol="modbus", operation="write_holding", writes=True)
    assert envelope["success"] is False
    assert envelope["error"]["code"] == "illegal_address"
    assert envelope["error"]["outcome"] == "unknown"
    assert envelope["meta"]["synthesised"] is True


@pytest.mark.parametrize(
    ("document", "success"),
    [
        ({"success": False}, False),
        ({"ok": False, "data": 1}, False),
        ({"error": "no such register"}, False),
        ({"error": {"code": 2}}, False),
        ({"result": {"success": False}}, False),
        ({"success": True, "error": "none"}, True),
        ({"error": ""}, True),
        ({"error": None, "value": 1}, True),
        ({"value": False}, True),
    ],
)
def test_a_structured_answer_that_calls_itself_a_failure_is_one(document: dict[str, Any], success: bool) -> None:
    message = {"result": {"content": [{"type": "text", "text": json.dumps(document)}], "isError": False}}
    assert interpret(message, Answering(form="json")).success is success
    overruled = Answering(form="json", outcome=(OutcomeRule(success=True, is_error=False),))
    assert interpret(message, overruled).success is True
