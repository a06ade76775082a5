"""A proposal for an adapter is guessed from its tools and found in its answers."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.onboarding.document import Draft, write_document
from pytest_otmcp.onboarding.drafting import describe_launch
from pytest_otmcp.onboarding.evidence import (
    CONNECT_FAILED,
    CONNECTION_LOST,
    TIMEOUT,
    Sample,
    failure_rules,
    find,
    known_errors,
    lists_in,
    no_result,
    prose_rule,
    same_value,
    turned_false,
)
from pytest_otmcp.onboarding.guess import Guess
from pytest_otmcp.onboarding.known_causes import find_advice
from pytest_otmcp.onboarding.matching import guess_steps, guess_tools, registered
from pytest_otmcp.onboarding.pack import load_pack
from pytest_otmcp.onboarding.product_version import product_version
from pytest_otmcp.onboarding.proposal import Proposal, by_name
from pytest_otmcp.onboarding.switches import switches_of
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.subject.answers import extract, read_answer
from pytest_otmcp.subject.model import OutputRule


def tool(required: str = "", optional: str = "", **schemas: Any) -> dict[str, Any]:
    properties: dict[str, Any] = {name: {"type": "integer"} for name in (required + " " + optional).split()}
    return {"inputSchema": {"type": "object", "properties": properties | schemas, "required": required.split()}}


def guesses(protocol: str, operation: str, tools: Mapping[str, Mapping[str, Any]]) -> list[Guess]:
    return guess_tools(load_pack(protocol), operation, tools)


PROSE_MODBUS = {
    "read_register": tool("address", "slave_id"),
    "write_register": tool("address value", "slave_id"),
    "read_coils": tool("address count", "slave_id"),
    "read_input_registers": tool("address count", "slave_id"),
    "read_multiple_holding_registers": tool("address count", "slave_id"),
}


@pytest.mark.parametrize(
    ("operation", "expected"),
    [
        ("read_input", "read_input_registers"),
        ("read_holding", "read_multiple_holding_registers"),
        ("write_holding", "write_register"),
    ],
)
def test_the_likeliest_tool_is_the_right_one(operation: str, expected: str) -> None:
    best = guesses("modbus", operation, PROSE_MODBUS)[0]
    assert best.tool == expected
    assert best.arguments["address"] == "$address"
    # An argument that is not required is given when it does not work without.
    assert [variation.arguments.get("slave_id") for variation in best.variations()] == [None, 1]


def test_other_verbs_are_understood_as_well() -> None:
    tools = {
        "fetch_registers": tool("start quantity"),
        "putRegister": tool("register value"),
        "put_coil": tool("coil on"),
        "put_registers": tool("start values"),
    }
    for operation, expected in (
        ("read_holding", "fetch_registers"),
        ("write_holding", "putRegister"),
        ("write_registers", "put_registers"),
        ("write_coil", "put_coil"),
    ):
        assert [guess.tool for guess in guesses("modbus", operation, tools)][:1] == [expected], operation


def test_a_coil_is_no_register() -> None:
    tools = {"write_coil": tool("address value"), "write_register": tool("address value")}
    assert guesses("modbus", "write_holding", tools)[0].tool == "write_register"


def test_nodes_and_values_are_put_into_lists_of_objects() -> None:
    nodes = {"type": "array", "items": {"$ref": "#/$defs/Item"}}
    listing = tool("nodes", nodes=nodes)
    listing["inputSchema"]["$defs"] = {"Item": {"type": "object", "properties": {"node_id": {}, "value": {}}}}
    (guess,) = guesses("opcua", "write", {"write_opcua_nodes": listing})
    assert guess.arguments == {"nodes": [{"node_id": "$node", "value": "$value"}]}


def test_an_endpoint_for_every_call_is_put_in() -> None:
    listing = tool("address count host port", host={"type": "string"}, port={"type": "integer"})
    (guess,) = guesses("modbus", "read_holding", {"read_registers": listing})
    assert (guess.arguments["host"], guess.arguments["port"]) == ("{host}", "{port:int}")


def test_the_one_argument_that_is_left_is_tried_for_the_one_input_that_is_left() -> None:
    (read,) = guesses("modbus", "read_holding", {"read_register": tool("address", "span")})
    assert [one.arguments for one in read.variations()] == [
        {"address": "$address"},
        {"address": "$address", "span": "$count"},
    ]
    (two,) = guesses("modbus", "read_holding", {"read_register": tool("address", "span pause")})
    assert [one.arguments for one in two.variations()] == [{"address": "$address"}]


def test_arguments_whose_names_say_nothing_are_tried_in_each_order() -> None:
    (read,) = guesses("modbus", "read_holding", {"get_word": tool("number how_many", "slave_id")})
    told = [{name: one.arguments[name] for name in ("number", "how_many")} for one in read.variations()]
    assert told == [
        {"number": "$address", "how_many": "$count"},
        {"number": "$count", "how_many": "$address"},
    ]
    (write,) = guesses("modbus", "write_holding", {"put_word": tool("content place")})
    assert [{**one.arguments} for one in write.variations()][-1] == {"content": "$value", "place": "$address"}
    # One argument cannot say what is written and where.
    assert guesses("modbus", "write_holding", {"set_speed": tool("rpm")}) == []


def test_what_an_argument_wants_to_be_told_is_tried() -> None:
    listing = tool("address count conn kind")
    (guess,) = guesses("modbus", "read_holding", {"modbus_read": listing})
    variations = [variation.arguments for variation in guess.variations()]
    assert {"conn", "kind"} <= set(variations[0])
    assert any((entry["conn"], entry["kind"]) == ("tcp:{host}:{port}", "hr") for entry in variations)
    assert len(variations) <= 24


def test_a_place_in_a_configuration_file_is_not_taken_for_an_address_before_the_call_without_it() -> None:
    listing = tool("address count", endpoint={"type": "string"}, unit_id={"type": "integer"})
    (guess,) = guesses("modbus", "read_holding", {"read_registers": listing})
    added = [{*variation.arguments} - {"address", "count"} for variation in guess.variations()]
    assert added == [set(), {"unit_id"}, {"unit_id", "endpoint"}]


def test_a_dry_run_is_said_to_be_none() -> None:
    default = {"type": "boolean", "default": True}
    (guess,) = guesses("mqtt", "publish", {"mqtt_publish": tool("topic payload", dry_run=default)})
    assert guess.arguments["dry_run"] is False
    (guess,) = guesses("mqtt", "publish", {"mqtt_publish": tool("topic payload", dry_run={"type": "boolean"})})
    assert "dry_run" not in guess.arguments


def test_of_alternatives_the_one_for_the_table_is_taken() -> None:
    def alternative(table: str, *names: str) -> dict[str, Any]:
        properties = {name: {"type": "array", "items": {"type": "integer"}} for name in names}
        return {"properties": {"target": {"const": table}, "address": {}, **properties}, "required": ["target", *names]}

    listing = tool("target", target={"anyOf": [{"const": "coils"}, {"const": "holding"}]}, value={}, values={})
    listing["inputSchema"]["oneOf"] = [alternative("coils", "value"), alternative("holding", "values")]
    (guess,) = guesses("modbus", "write_holding", {"write_values": listing})
    assert guess.arguments == {"target": "holding", "address": "$address", "values": ["$value"]}
    assert guess.missing == ()


def test_bytes_and_a_typed_value_of_a_data_block_are_two_alternatives_of_one_tool() -> None:
    listing = tool("source", source={"anyOf": [{"const": "db"}, {"const": "db_typed"}, {"const": "marker"}]})
    listing["inputSchema"]["oneOf"] = [
        {"properties": {"source": {"const": source}} | {name: {} for name in names}, "required": ["source", *names]}
        for source, names in (
            ("db", ("db_number", "start_offset", "size")),
            ("db_typed", ("db_number", "start_offset", "data_type")),
            ("marker", ("start_byte", "size")),
        )
    ]
    (block,) = guesses("s7", "read_db", {"read_values": listing})
    assert block.arguments == {"source": "db", "db_number": "$db", "start_offset": "$start", "size": "$size"}
    (typed,) = guesses("s7", "read_typed", {"read_values": listing})
    assert typed.arguments == {"source": "db_typed", "db_number": "$db", "start_offset": "$start", "data_type": "$type"}


def test_a_bacnet_device_is_addressed_and_its_present_value_named() -> None:
    listing = tool("device_id object_type object_instance property_id value", "priority", address={"type": "string"})
    (guess,) = guesses("bacnet", "write", {"write_property": listing})
    assert guess.arguments == {
        "device_id": "$device",
        "object_type": "$type",
        "object_instance": "$instance",
        "property_id": "present-value",
        "value": "$value",
        "priority": "$priority",
    }
    assert [entry.arguments.get("address") for entry in guess.variations()] == [None, "{host}:{port}"]
    assert guesses("bacnet", "read", {"write_property": listing}) == []


def test_a_tool_that_subscribes_and_waits_may_give_messages() -> None:
    assert guesses("mqtt", "messages", {"mqtt_subscribe": tool("topic", "qos")}) == []
    (guess,) = guesses("mqtt", "messages", {"mqtt_subscribe": tool("topic", "timeout")})
    assert guess.arguments == {"topic": "$filter", "timeout": "$seconds"}


def test_what_nothing_is_known_about_is_named() -> None:
    listing = tool("address count licence")
    (guess,) = guesses("modbus", "read_holding", {"read_registers": listing})
    assert guess.missing == ("licence",)


def test_a_connect_step_is_recognised() -> None:
    tools = {
        "mqtt_disconnect": tool(),
        "mqtt_connect": tool(broker_host={"type": "string"}, broker_port={"type": "integer"}),
    }
    (step,) = guess_steps(load_pack("mqtt"), tools)
    assert (step.tool, step.arguments) == ("mqtt_connect", {"broker_host": "{host}", "broker_port": "{port:int}"})


def texts(names: str) -> dict[str, Any]:
    return {name: {"type": "string"} for name in names.split()}


@pytest.mark.parametrize(
    ("protocol", "name", "listing", "arguments", "trials"),
    [
        (
            "s7",
            "connect_plc",
            tool("address rack slot tcp_port", **texts("address")),
            {"address": "{host}", "rack": 0, "slot": 1, "tcp_port": "{port:int}"},
            {},
        ),
        (
            "modbus",
            "connect_device",
            tool("target_ip", "unit_id", **texts("target_ip")),
            {"unit_id": 1},
            {"target_ip": ("{host}:{port}", "{url}", "{host}")},
        ),
        ("opcua", "open_session", tool("server_url", **texts("server_url")), {"server_url": "{url}"}, {}),
        (
            "modbus",
            "add_device",
            tool("name host port type", **texts("name host"), type={"enum": ["bacnet", "modbus-tcp"]}),
            {"name": "otmcp", "host": "{host}", "port": "{port:int}", "type": "modbus-tcp"},
            {},
        ),
    ],
)
def test_a_step_is_told_the_device_by_whatever_name(
    protocol: str, name: str, listing: dict[str, Any], arguments: dict[str, Any], trials: dict[str, Any]
) -> None:
    tools = {name: listing, "read_holding_registers": tool("device_id address count", **texts("device_id"))}
    (step,) = guess_steps(load_pack(protocol), tools)
    assert (step.tool, step.arguments, step.trials, step.missing) == (name, arguments, trials, ())


def test_a_step_that_needs_what_nobody_knows_says_so() -> None:
    (step,) = guess_steps(load_pack("s7"), {"connect_plc": tool("address licence port", **texts("address licence"))})
    assert step.missing == ("licence",)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("connect", ""),
        ("connection_status", "host port"),
        ("disconnect", "host port"),
        ("list_connections", "host"),
        ("remove_device", "name host"),
        ("opcua_connect", "host port"),
        ("add_note", "name host"),
    ],
)
def test_what_is_not_told_where_the_device_is_or_does_something_else_is_no_step(name: str, arguments: str) -> None:
    tools = {name: tool(arguments), "read_holding_registers": tool("name address count")}
    assert guess_steps(load_pack("modbus"), tools) == []


def test_a_device_is_only_registered_where_another_tool_is_told_its_name() -> None:
    add = tool("name host port", **texts("name host"))
    pack = load_pack("modbus")
    assert guess_steps(pack, {"add_device": add, "read_holding_registers": tool("address count")}) == []
    reading = tool("device_id address count", **texts("device_id"))
    (step,) = guess_steps(pack, {"add_device": add, "read_holding_registers": reading})
    (guess,) = guess_tools(pack, "read_holding", {"read_holding_registers": reading}, registered(step))
    assert guess.arguments == {"device_id": "otmcp", "address": "$address", "count": "$count"}
    assert guess.missing == ()
    assert registered(None) == {}


def answer(text: str, structured: Any = None) -> dict[str, Any]:
    result: dict[str, Any] = {"content": [{"type": "text", "text": text}]}
    if structured is not None:
        result["structuredContent"] = structured
    return {"result": result}


def blocks(*texts: str) -> dict[str, Any]:
    return {"result": {"content": [{"type": "text", "text": text} for text in texts]}}


@pytest.mark.parametrize(
    ("message", "expected"),
    [
        (answer("Slave 1, Input Registers 0 to 3: [250, 150, 60]"), [250, 150, 60]),
        (answer("250,150,60"), [250, 150, 60]),
        (answer('{"registers": [250, 150, 60]}'), [250, 150, 60]),
        (answer("x", {"data": {"raw_bytes_hex": "fa963c"}}), [250, 150, 60]),
        (answer("fa963c"), [250, 150, 60]),
        (answer("x", {"result": '{"raw": [250, 150, 60]}'}), [250, 150, 60]),
        (answer("x", {"items": [{"value": 1.5}, {"value": 2.5}]}), [1.5, 2.5]),
        (answer("Node ns=2;s=T has the value: 41.25 °C"), 41.25),
        (answer("x", {"data": {"value": 41.25, "source_timestamp": "2026"}}), 41.25),
        (answer("The pump is True now"), True),
        (blocks('{"node": "a", "value": 1.5}', '{"node": "b", "value": 2.5}'), [1.5, 2.5]),
    ],
    ids=[
        "brackets",
        "bare",
        "json in text",
        "hexadecimal",
        "bare hexadecimal",
        "json in json",
        "objects",
        "sentence",
        "structured",
        "boolean",
        "blocks",
    ],
)
def test_a_known_value_is_found_and_its_rule_finds_it_again(message: Mapping[str, Any], expected: Any) -> None:
    found = find([Sample(message=message, expected=expected)])
    assert found is not None
    rule = OutputRule(**{{"as": "convert"}.get(name, name): value for name, value in found.rule.items()})
    assert extract({"x": rule}, read_answer(message, found.form)[0]) == {"x": expected}


def sample(message: Mapping[str, Any], expected: Any, **told: Any) -> Sample:
    return Sample(message=message, expected=expected, told=told)


def prose(node: str, value: object, *, after: str = "") -> Mapping[str, Any]:
    return answer(f"Node {node} value: {value}{after}")


SENTENCES = [(41.25, "41.25"), (-3, "-3"), (True, "True"), ([1, -2], "[1, -2]"), (" two, words ", " two, words ")]
"""Values, and how Python prints them."""


@pytest.mark.parametrize(
    ("samples", "rule"),
    [
        (
            [sample(answer("x", {"values": {node: value}}), value, node=node) for node, value in (("a", 1.5), ("b", 2.5))],
            {"path": 'values."$node"'},
        ),
        (
            [
                sample(answer("x", {one: {"v": 1}, other: {"v": 2}}), [1, 2], nodes=[one, other])
                for one, other in (("a", "b"), ("d", "c"))
            ],
            {"path": '"$nodes"[].v'},
        ),
        (
            [sample(answer("x", {"result": json.dumps({"v": {node: 7}})}), 7, node=node) for node in ("a", "b")],
            {"path": "result", "as": "json", "then": 'v."$node"'},
        ),
        (
            [sample(prose("n", said), value, node=said) for value, said in SENTENCES],
            {"regex": r"(?s)value: (.*)$", "as": "literal"},
        ),
        (
            [sample(prose("n", said, after=" (Good)"), value, node=said) for value, said in SENTENCES],
            {"regex": r"(?s)value: (.*?) \(", "as": "literal"},
        ),
        (
            [sample(answer(f"ns=2;s={name} = {value}"), value, node=name) for name, value in (("a", 1.5), ("b", 2.5))],
            {"regex": r"(?s)^.*= (.*)$", "as": "literal"},
        ),
        (
            [sample(answer("x", {"v": value}), value, node=said) for value, said in SENTENCES],
            {"path": "v"},
        ),
        ([sample(answer(f"the value of {node} is {value}"), value, node=node) for node, value in (("a", 1), ("b", 2))], {"regex": r"(?s)is (.*)$", "as": "literal"}),
        (
            [sample(answer(f"value:{value:>10}"), value, node=node) for node, value in (("a", 1.5), ("b", 12.25))],
            {"regex": r"(?s)value:\s*(.*)$", "as": "literal"},
        ),
        (
            [sample(answer(f"Holding registers: {said}"), values) for values, said in (([1, -2], "[1, -2]"), ([7], "7"))],
            {"regex": r"[\[:=]\s*([^\[\]:=]*?)\]?\s*$", "split": ",", "as": "int"},
        ),
        ([sample(answer("value: 1.5"), 1.5, node="a"), sample(answer("value: 1.5"), 2.5, node="b")], None),
    ],
    ids=["member", "members", "in a text", "prose", "with a quality", "after the name", "typed", "sentence", "in a column", "one alone", "always the same"],
)  # fmt: skip
def test_a_place_is_right_for_every_answer(samples: list[Sample], rule: Mapping[str, object] | None) -> None:
    found = find(samples, ("structured", "text"))
    assert (None if found is None else found.rule) == rule
    assert found is None or not found.missed


def test_a_pattern_of_one_type_does_not_take_everything() -> None:
    first, *others = [sample(prose("n", said, after=" bar"), value, node=said) for value, said in SENTENCES]
    found = find([first, *others])
    assert found is not None
    assert not found.takes_everything
    assert [missed.expected for missed in found.missed] == [[1, -2], " two, words "]


def test_a_place_that_takes_everything_is_found_although_one_answer_is_wrong() -> None:
    wrong = sample(answer("x", {"v": 9007199254740992.0}), 9007199254740993, node="c")
    right = [sample(answer("x", {"v": value}), value, node=node) for node, value in (("a", 1.5), ("b", 2.5))]
    found = find([*right, wrong])
    assert found is not None
    assert (found.rule, found.missed, found.takes_everything) == ({"path": "v"}, (wrong,), True)


def test_a_place_that_has_the_value_of_one_call_alone_is_none() -> None:
    said = [
        sample(answer("x", {"v": 1.5}), value, node=node)
        for node, value in (("a", 1.5), ("a", 1.5), ("b", 2.5), ("c", 3.5))
    ]
    assert find(said) is None
    assert find(said[:2]) is not None


@pytest.mark.parametrize(
    ("found", "expected", "same"),
    [
        ("9007199254740993", 9007199254740993, True),
        (9007199254740992.0, 9007199254740993, False),
        ("7", 7, False),
        ("2026-11-22 12:00:00.5", "2026-11-22T12:00:00.500+00:00", True),
        ("2026-11-22T12:00:00.500Z", "2026-11-22T12:00:00.500+00:00", True),
        ("2026-11-22T13:00:00.500Z", "2026-11-22T12:00:00.500+00:00", False),
        ("2026-11-22 yesterday", "2026-11-22T12:00:00.500+00:00", False),
        (1, True, False),
        (False, False, True),
        (5.0, 5, True),
        ([1, True], [1, 1], False),
    ],
)
def test_what_says_a_value_is_told_from_what_does_not(found: object, expected: object, same: bool) -> None:
    assert same_value(found, expected) is same


@pytest.mark.parametrize(
    ("message", "why"),
    [
        ({"result": {"content": [{"type": "text", "text": "7"}]}}, None),
        ({"result": {"content": []}}, None),
        ({"result": {"content": [{"type": "json", "json": 7}]}}, "a content block of the type 'json', which MCP does not know"),
        ({"result": {"content": ["7"]}}, "a content block of the type None, which MCP does not know"),
        ({"result": {"content": [{"type": "text"}]}}, "a text block without a text"),
        ({"result": {"value": 7}}, "a result whose content is no list"),
        ({"result": 7, "id": 1}, "error None instead of a result: 'None'"),
        ({"error": {"code": -32602, "message": "Invalid\n result"}}, "error -32602 instead of a result: 'Invalid result'"),
    ],
)  # fmt: skip
def test_an_answer_that_is_no_result_of_a_tool_call_is_said_to_be_none(
    message: Mapping[str, Any], why: str | None
) -> None:
    assert no_result(message) == why


def test_a_value_that_is_not_there_is_not_found() -> None:
    message = answer("Registers: [0, 0, 0]", {"values": [0, 0, 0]})
    assert find([Sample(message=message, expected=[250, 150, 60])]) is None


def test_a_list_of_nodes_may_begin_with_the_node_that_was_asked_for() -> None:
    message = blocks('{"node_id": "ns=2;i=1"}', '{"node_id": "ns=2;i=2"}', '{"node_id": "ns=2;i=3"}')
    found = {rule["path"]: nodes for form, rule, nodes in lists_in(message)}
    assert found["[1:].node_id"] == ["ns=2;i=2", "ns=2;i=3"]


@pytest.mark.parametrize("shown", ["{'ns=2;s=A': 20.5, 'ns=2;s=B': None}", '{"ns=2;s=A": 20.5, "ns=2;s=B": null}'])
def test_values_are_found_in_an_object_behind_words(shown: str) -> None:
    nodes = ["ns=2;s=A", "ns=2;s=B"]
    found = find([sample(answer(f"Read multiple nodes values: {shown}"), [20.5, None], nodes=nodes)])
    assert found is not None
    assert (found.form, found.rule["as"], found.rule["then"]) == ("text", "literal", '"$nodes"')


def test_a_list_of_nodes_is_found_behind_words() -> None:
    message = answer("Children of i=85: [{'node_id': 'ns=2;i=1', 'name': 'A'}, {'node_id': 'ns=2;i=2', 'name': 'B'}]")
    found = {rule.get("then"): nodes for form, rule, nodes in lists_in(message) if form == "text"}
    assert found["[].node_id"] == ["ns=2;i=1", "ns=2;i=2"]


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ({"connected": True}, {"connected": False}, "connected"),
        ({"state": "connected"}, {"state": "closed"}, "state == 'connected'"),
        ({"verdict": "ok", "hops": [{"up": True}]}, {"verdict": "bad", "hops": [{"up": False}]}, "hops[0].up"),
        ({"connected": True}, {"connected": True}, None),
        ({"connected": True}, {}, None),
    ],
)
def test_the_place_that_says_no_without_the_device_is_found(
    before: dict[str, Any], after: dict[str, Any], expected: str | None
) -> None:
    found = turned_false(answer("x", before), answer("x", after))
    assert (None if found is None else found.rule["path"]) == expected


@pytest.mark.parametrize(
    ("failure", "success", "form", "expected"),
    [
        (answer("Error reading 9999"), answer("Wrote 5"), "text", [{"text": "(?i)^\\W*error", "then": "failure"}]),
        (
            answer('{"errors": ["no such topic"]}'),
            answer('{"errors": []}'),
            "json",
            [{"path": "errors", "then": "failure"}],
        ),
        (answer('{"success": false}'), answer('{"success": true}'), "json", []),
        (
            answer("x", {"result": [{"status": "BadNodeIdUnknown"}]}),
            answer("x", {"result": [{"status": "Good"}]}),
            "structured",
            [{"path": "result[?status && status != 'Good']", "then": "failure"}],
        ),
        (
            blocks('{"error": "no such node"}'),
            blocks('{"value": 1}'),
            "texts",
            [{"path": "[?error]", "then": "failure"}],
        ),
        (
            answer("x", {"values": {"ns=2;i=9": {"error": "no such node"}}}),
            answer("x", {"values": {"ns=2;i=1": 40.5}}),
            "structured",
            [{"path": "values.*.error | [0]", "then": "failure"}],
        ),
        (answer("nothing special"), answer("nothing special"), "text", []),
        ({"result": {"isError": True, "content": []}}, answer("ok"), "text", []),
    ],
    ids=[
        "prose",
        "list of errors",
        "says so itself",
        "status",
        "block",
        "below a name",
        "not to be told",
        "isError tells",
    ],
)
def test_a_rule_tells_the_failure_from_the_success(
    failure: Mapping[str, Any], success: Mapping[str, Any], form: str, expected: list[dict[str, Any]]
) -> None:
    assert failure_rules(failure, [success], form) == expected


@pytest.mark.parametrize(
    ("success", "failure"),
    [
        ("Message published to topic a/b", "Failed to publish message to topic 'a/b' (Timeout or Error)"),
        ("Message published successfully", "MQTT connection or publish error: [Errno 111] Connection refused"),
        ("Wrote 40 to register 5", "Error: QoS must be 0, 1, or 2."),
    ],
)
def test_a_tool_that_answers_in_sentences_is_given_a_rule_for_failures_told_so(success: str, failure: str) -> None:
    rule = prose_rule(answer(success))
    assert rule is not None
    assert re.search(rule["text"], failure)
    assert not re.search(rule["text"], success)


@pytest.mark.parametrize("success", ["40.5", "ok", '{"error": null}', "Error count is 0 now"])
def test_a_tool_that_answers_otherwise_is_not(success: str) -> None:
    assert prose_rule(answer(success)) is None


@pytest.mark.parametrize(
    ("words", "cause", "remedy"),
    [
        ("ModuleNotFoundError: No module named 'mcp.server.fastmcp'", "version 1 of the MCP SDK", "mcp<2"),
        ("AttributeError: 'Server' object has no attribute 'list_tools'", "version 1 of the MCP SDK", "mcp<2"),
        ("No module named 'fastmcp.prompts.prompt'", "earlier version of FastMCP", "fastmcp<3"),
        ("got an unexpected keyword argument 'slave'", "earlier version of pymodbus", "pymodbus<3.10"),
        ("ModuleNotFoundError: No module named 'opcua'", "The module opcua is not installed", "interpreter"),
        ("OSError: [Errno 98] Address already in use", "in use", "{http_port}"),
        ("ConnectionRefusedError: [Errno 111] Connection refused", "tried another address", "{host}"),
        ("the command 'acme' was not found; the launch command is: acme", "no program acme", "PATH"),
        ("the adapter did not finish its handshake within 30 s", "does not speak MCP", 'transport = "http"'),
        ("RuntimeWarning: coroutine 'main' was never awaited", "without awaiting", "python -m"),
    ],
)
def test_a_known_cause_is_recognised_and_has_a_remedy(words: str, cause: str, remedy: str) -> None:
    (first, *_) = find_advice(words, load_pack("modbus").causes)
    assert cause in first.cause
    assert remedy in first.remedy


def test_an_unknown_cause_is_not_guessed_at() -> None:
    assert find_advice("the spindle is out of oil", load_pack("modbus").causes) == []


@pytest.mark.parametrize("protocol", [key for key, known in protocols().items() if known.onboarding is not None])
def test_a_pack_has_hints_for_every_operation_and_names_for_what_is_put_in(protocol: str) -> None:
    pack, operations = load_pack(protocol), protocols()[protocol].operations
    assert pack.protocol == protocol
    assert set(pack.operations) == set(operations)
    waits = {operation.waits for operation in operations.values()}
    assert {name for operation in operations.values() for name in operation.inputs} - waits <= {
        *pack.arguments,
        "value",
    }


NAMING_THEIR_TARGET = {
    "modbus": {"write_registers", "write_coil", "write_coils", "mask_write"},
    "mqtt": {"send_node_command", "send_device_command"},
    "opcua": {"write_many"},
}
"""Voluntary operations that write, and are told what: cells, variables, or that the mock's own edge node is to do it."""


@pytest.mark.parametrize("protocol", ["modbus", "mqtt", "opcua"])
def test_a_voluntary_operation_that_writes_is_called_only_where_it_names_its_target(protocol: str) -> None:
    hints = load_pack(protocol).operations
    tried = set()
    for name, operation in protocols()[protocol].operations.items():
        if operation.voluntary:
            assert hints[name].named is not None, name
            if hints[name].experiment is not None and operation.writes:
                tried.add(name)
    assert tried == NAMING_THEIR_TARGET.get(protocol, set())


@pytest.mark.parametrize(
    ("operation", "name", "arguments", "expected"),
    [
        ("write_coils", "write_coils", "address values", True),
        ("write_coils", "write_coils", "address values why", False),
        ("write_coils", "write_coils", "address", False),
        ("write_coil", "write_coils", "address value", False),
        ("write_registers", "write_register", "address values", False),
        ("mask_write", "mask_write_register", "address and_mask or_mask", True),
        ("read_tag", "read_tag_history", "tag", False),
        ("read_coils", "read_discrete_inputs", "address count", False),
    ],
)
def test_a_voluntary_operation_is_proposed_for_a_tool_that_plainly_matches(
    operation: str, name: str, arguments: str, expected: bool
) -> None:
    assert bool(guesses("modbus", operation, {name: tool(arguments)})) is expected


def drafted(**known: Any) -> Draft:
    """Return a draft of which nothing is known but this."""
    nothing: dict[str, Any] = {
        "protocol": "modbus",
        "name": "x",
        "server_version": "1",
        "product_version": None,
        "command": ["x"],
        "env": {},
        "secret_env": (),
        "files": {},
        "era": None,
        "transport_url": None,
        "native": True,
        "proposals": {},
        "commands": {},
        "connect": None,
        "readiness": None,
        "recovery": None,
        "tools": [],
        "started_s": 0.1,
        "longest_s": 0.1,
        "errors": {},
    }
    return Draft(**{**nothing, **known})


@pytest.mark.parametrize(
    ("protocol", "missing"),
    [
        ("modbus", {"ping", "read_input", "read_holding", "write_holding"}),
        ("mqtt", {"info", "subscribe", "messages", "publish", "device_birth", "device_data"}),
    ],
)
def test_what_was_not_found_is_declared_as_unclaimed_with_a_reason_that_says_who_looked(
    protocol: str, missing: set[str]
) -> None:
    draft = drafted(protocol=protocol, tools=["other"])
    text = write_document(draft)
    unclaimed = tomllib.loads(text)["adapter"][protocol]["unclaimed"]
    assert unclaimed.pop("guard") == "otmcp init does not know how writes are disabled"
    assert unclaimed == dict.fromkeys(missing, "otmcp init found no tool for it")
    assert "# Not proven, only proposed: take a line away when the adapter has what it names" in text
    assert all(
        f"# No tool is called like one for it: {protocols()[protocol].operations[name].meaning}.\n{name} = " in text
        for name in missing
    )
    assert {sentence.partition(" (")[0] for sentence in draft.left} >= missing
    assert 'version = "unknown"' in text
    assert "the version of your product" in draft.left
    # What is proposed for it is a binding whose capitals are to be filled in.
    kept = [line for line in text.splitlines() if not line.startswith(tuple(f"{name} = " for name in missing))]
    bound = [
        line.removeprefix("# ") if line.startswith(tuple(f"# {name} = " for name in missing)) else line for line in kept
    ]
    assert tomllib.loads("\n".join(bound))["adapter"][protocol]["bind"].keys() == missing


def test_a_tool_that_is_only_a_guess_is_not_declared_as_unclaimed() -> None:
    (guess,) = guesses("modbus", "ping", {"ping_status": tool("licence")})
    likely = Proposal(guess=guess, proven=False, evidence=["not tried"])
    text = write_document(drafted(proposals={"ping": likely}))
    assert "ping" not in tomllib.loads(text)["adapter"]["modbus"]["unclaimed"]
    assert "# Only a guess; take the comment signs away when it is right." in text


def test_a_variable_that_is_called_so_is_proposed_as_the_switch_for_writes() -> None:
    env = {"PLC_HOST": "{host}", "PLC_WRITES": "1", "PLC_READ_ONLY": "no"}
    texts = ["Write a register; needs ALLOW_WRITE. Set PLC_HOST.", "READ_ONLY_MODE forbids it."]
    launch = describe_launch("modbus", ["no-such-adapter"], env, url=None, deadline_s=5.0, start_timeout_s=5.0)
    text = write_document(drafted(env=env, switches=switches_of(launch, texts)))
    for name, disabled, enabled in (
        ("PLC_WRITES", "0", "1"),
        ("PLC_READ_ONLY", "yes", "no"),
        ("ALLOW_WRITE", "false", "true"),
        ("READ_ONLY_MODE", "true", "false"),
    ):
        assert (
            f'# ro = {{ env = {{ {name} = "{disabled}" }} }}\n# rw = {{ env = {{ {name} = "{enabled}" }} }}\n' in text
        )
    assert "# PLC_HOST" not in text
    assert "ro" not in tomllib.loads(text)["adapter"]["modbus"]


@pytest.mark.parametrize(
    ("name", "source", "switches"),
    [
        ("x.py", 'if os.environ.get("PLC_WRITES") != "true":', {"PLC_WRITES": ("false", "true")}),
        ("x.py", "os.environ['READONLY']", {"READONLY": ("true", "false")}),
        ("x.py", 'parser.add_argument("--allow-writes", action="store_true")', {"--allow-writes": (None, "given")}),
        ("x.py", 'parser.add_argument("--read-only", action="store_true")', {"--read-only": ("given", None)}),
        (
            "x.py",
            'class S(BaseSettings):\n    model_config = {}\n    read_only: bool = True\nS(env_prefix="OPCUA_")',
            {"OPCUA_READ_ONLY": ("true", "false")},
        ),
        ("x.mjs", "const on = process.env.ENABLE_WRITE === 'true'", {"ENABLE_WRITE": ("false", "true")}),
        ("x.mjs", "z.object({ ALLOW_DEVICE_WRITES: z.string() })", {"ALLOW_DEVICE_WRITES": ("false", "true")}),
        ("x.py", 'os.environ.get("WRITE_TIMEOUT_S"); os.getenv("MQTT_WRITE_TOPIC"); WRITE_SINGLE_COIL = 5', {}),
    ],
)
def test_what_may_disable_writes_is_found_in_the_adapters_own_files(
    tmp_path: Path, name: str, source: str, switches: dict[str, tuple[str | None, str | None]]
) -> None:
    (tmp_path / name).write_text(source, encoding="utf-8")
    launch = describe_launch(
        "modbus", ["python", str(tmp_path / name)], {}, url=None, deadline_s=5.0, start_timeout_s=5.0
    )
    found = switches_of(launch, ())
    first = {one.name: one for one in reversed(found)}

    def set_to(entries: Mapping[str, Any]) -> str | None:
        return "given" if "args" in entries else next(iter(entries.get("env", {}).values()), None)

    assert {one.name: (set_to(one.ro), set_to(one.rw)) for one in first.values()} == switches
    # A variable may be set by 1 and 0 as well, or by anything at all.
    assert len(found) == sum(1 if name.startswith("--") else 3 for name in switches)


def test_the_version_of_the_product_is_that_of_its_package(tmp_path: Path) -> None:
    (tmp_path / "src").mkdir()
    program = tmp_path / "src" / "server.mjs"
    program.write_text("// nothing", encoding="utf-8")
    assert product_version(["node", str(program)], tmp_path) is None
    (tmp_path / "package.json").write_text('{"name": "x", "version": "3.1.4"}', encoding="utf-8")
    assert product_version(["node", str(program)], tmp_path) == ("3.1.4", "package.json")
    text = write_document(drafted(product_version=("3.1.4", "package.json")))
    assert '# By package.json.\nversion = "3.1.4"\n' in text


@pytest.mark.parametrize("packed", [False, True])
def test_the_version_of_a_program_without_a_description_is_the_commit_of_its_repository(
    tmp_path: Path, packed: bool
) -> None:
    commit = "0123456789abcdef0123456789abcdef01234567"
    (tmp_path / ".git" / "refs" / "heads").mkdir(parents=True)
    (tmp_path / ".git" / "HEAD").write_text("ref: refs/heads/main\n", encoding="utf-8")
    listed, text = (
        ("packed-refs", f"# pack-refs with: peeled\n{commit} refs/heads/main\n")
        if packed
        else ("refs/heads/main", f"{commit}\n")
    )
    (tmp_path / ".git" / listed).write_text(text, encoding="utf-8")
    (tmp_path / "server.py").write_text("", encoding="utf-8")
    found = product_version(["python", str(tmp_path / "server.py")], tmp_path)
    assert found is not None
    assert found[0] == "0123456"


def test_the_version_of_an_installed_package_is_that_of_its_metadata(tmp_path: Path) -> None:
    packages = tmp_path / "lib" / "python3.11" / "site-packages"
    (packages / "plant").mkdir(parents=True)
    (packages / "plant-2.7.dist-info").mkdir()
    (packages / "plant" / "__main__.py").write_text("", encoding="utf-8")
    (packages / "plant-2.7.dist-info" / "RECORD").write_text("plant/__main__.py,sha256=x,0\n", encoding="utf-8")
    (packages / "plant-2.7.dist-info" / "METADATA").write_text("Name: plant\nVersion: 2.7\n", encoding="utf-8")
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "plant").write_text("#!/usr/bin/python3\nimport plant\n", encoding="utf-8")
    (tmp_path / "bin" / "plant").chmod(0o755)
    assert product_version([str(tmp_path / "bin" / "plant")], tmp_path) == ("2.7", "plant-2.7.dist-info")


def test_a_voluntary_operation_is_proposed_as_a_comment_and_is_no_work_for_the_user() -> None:
    found = by_name(guesses("modbus", "mask_write", {"mask_write": tool("address and_mask or_mask")}))
    assert found is not None
    draft = drafted(proposals={"mask_write": found}, tools=["mask_write"])
    text = write_document(draft)
    assert "# likely: by its name and its arguments; not called\n" in text
    assert '# tool = "mask_write"\n' in text
    assert tomllib.loads(text)["adapter"]["modbus"]["bind"] == {}
    assert not any("mask_write" in sentence for sentence in draft.left)
    assert "read_coils" not in text


def test_a_protocol_without_a_pack_is_refused_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    bare = replace(protocols()["modbus"], name="S7comm", onboarding=None)
    monkeypatch.setattr("pytest_otmcp.onboarding.pack.protocols", lambda: {"s7": bare})
    with pytest.raises(UsageError, match="otmcp init cannot propose bindings for S7comm yet"):
        load_pack("s7")


def test_a_tool_of_another_protocol_is_never_guessed() -> None:
    described = {
        "ethercat_sdo_write": tool("address value"),
        "write_tag": tool("address value") | {"description": "Write a register of an EtherNet/IP device."},
        "opcua_write": tool("address value"),
    }
    assert guesses("modbus", "write_holding", described) == []
    named = tool("address value") | {"description": "Write a value; Modbus has another tool for that."}
    assert guesses("modbus", "write_holding", {"eip_write_register": named}) == []
    both = tool("address value") | {"description": "Write a register over Modbus or EtherCAT."}
    assert [guess.tool for guess in guesses("modbus", "write_holding", {"write_register": both})] == ["write_register"]


def test_a_tool_that_may_write_is_never_guessed_for_reading() -> None:
    tools = {
        "write_and_read_registers": tool("address count"),
        "read_and_clear_register": tool("address count") | {"annotations": {"destructiveHint": True}},
        "read_registers": tool("address count"),
    }
    assert [guess.tool for guess in guesses("modbus", "read_holding", tools)] == ["read_registers"]


@pytest.mark.parametrize(
    ("protocol", "operation", "name", "arguments", "may_be_called"),
    [
        ("mqtt", "messages", "mqtt_unsubscribe", "topic", False),
        ("mqtt", "messages", "mqtt_receive_messages", "topic", True),
        ("mqtt", "messages", "get_and_clear_messages", "topic", False),
        ("mqtt", "messages", "clearReceivedMessages", "topic", False),
        ("mqtt", "messages", "read_messages_and_stop", "topic", False),
        ("mqtt", "subscribe", "start_subscription", "topic", True),
        ("mqtt", "subscribe", "unsubscribe_subscription", "topic", False),
        ("mqtt", "unsubscribe", "mqtt_unsubscribe", "topic", True),
        ("mqtt", "info", "reset_connection_status", "", False),
        ("mqtt", "info", "start_health_check", "", False),
        ("mqtt", "info", "get_start_status", "", True),
        ("modbus", "ping", "restart_health", "", False),
        ("modbus", "ping", "reconnect_status", "", False),
        ("modbus", "read_holding", "read_write_registers", "address count", False),
        ("modbus", "read_holding", "read_and_reset_registers", "address count", False),
        ("modbus", "read_holding", "reset_holding_registers", "address count", False),
        ("modbus", "read_holding", "plc_read_start_registers", "address count", True),
        ("modbus", "read_holding", "plc_start_read_registers", "address count", False),
        ("opcua", "read", "delete_node_value", "node_id", False),
        ("opcua", "read", "get_node_value", "node_id", True),
        ("opcua", "variables", "remove_all_variables", "", False),
    ],
)
def test_a_tool_whose_name_says_that_it_changes_something_is_never_called_as_a_read(
    protocol: str, operation: str, name: str, arguments: str, may_be_called: bool
) -> None:
    assert bool(guesses(protocol, operation, {name: tool(arguments)})) is may_be_called


@pytest.mark.parametrize(
    ("text", "codes"),
    [
        ("[Errno 111] Connection refused", ["connect_failed"]),
        ("failed to connect to 127.0.0.1", ["connect_failed"]),
        ("read error: Connection reset by peer", ["connection_lost"]),
        ("the connection was lost", ["connection_lost"]),
        ("connection lost; not connected", ["connection_lost"]),
        ("connection lost; could not connect again", []),
        ("Connection Refused: not authorised.", []),
        ("the device is offline", []),
        ("no such register", []),
    ],
)
def test_a_connection_that_broke_is_not_one_that_could_not_be_made(text: str, codes: list[str]) -> None:
    patterns = {"connect_failed": CONNECT_FAILED, "connection_lost": CONNECTION_LOST, "timeout": TIMEOUT}
    assert [rule["code"] for rule in known_errors(patterns, "connect_failed", text)] == codes


@pytest.mark.parametrize(
    ("text", "known"),
    [
        ("Request timed out", True),
        ("Modbus Error: No response received after 3 retries", True),
        ("read timeout", True),
        ("no response, connection closed", False),
        ("the timer is out of range", False),
        ("connection refused", False),
    ],
)
def test_a_device_that_did_not_answer_in_time_is_none_that_is_gone(text: str, known: bool) -> None:
    assert [rule["code"] for rule in known_errors({"timeout": TIMEOUT}, "timeout", text)] == ["timeout"] * known


@pytest.mark.parametrize(
    ("text", "tells"),
    [
        ("values: {'ns=2;s=A': 1.5, 'ns=2;s=B': 'Error reading node ns=2;s=B: BadNodeIdUnknown'}", True),
        ('values: [1.5, "error: no such node"]', True),
        ("values: {'ns=2;s=A': 1.5, 'error': None}", False),
        ("values: {'ns=2;s=A': 1.5, 'ns=2;s=B': 'no error'}", False),
    ],
)
def test_one_failure_among_several_results_is_told_from_a_success(text: str, tells: bool) -> None:
    good = [answer("values: {'ns=2;s=A': 1.5, 'ns=2;s=B': 'ready'}")]
    assert bool(failure_rules(answer(text), good, "text")) is tells


def test_a_list_behind_words_is_found_as_it_is() -> None:
    found = [rule for form, rule, texts in lists_in(answer("Subscribed: ['a/b', 'c/#']")) if texts == ["a/b", "c/#"]]
    assert found


def test_a_node_id_that_is_none_is_no_illegal_address() -> None:
    errors = load_pack("opcua").errors
    assert known_errors(errors, "illegal_address", "BadNodeIdInvalid") == []
    assert known_errors(errors, "illegal_address", "BadNodeIdUnknown") != []


@pytest.mark.parametrize(
    "odd",
    [
        {"properties": [["address"]]},
        {"properties": {"a": True}},
        {"properties": {"a": {"type": [{}], "enum": 5, "anyOf": 5}}},
        {"properties": {"a": {"type": 5}}, "required": {"a": 1}},
        {"$defs": 5, "properties": {"a": {"$ref": "#/$defs/x"}}},
        {"properties": {"a": {"$ref": "#/$defs/b"}}, "$defs": {"b": {f"p{at}": {"$ref": "#/$defs/b"} for at in range(400)}}},
    ],
)  # fmt: skip
def test_an_odd_schema_is_read_as_far_as_it_can_be(odd: dict[str, Any]) -> None:
    listing = {"read_registers": {"inputSchema": {"type": "object", **odd}}}
    assert all(guess.tool == "read_registers" for guess in guesses("modbus", "read_holding", listing))
