"""The arguments that checks make from a tool's schema: each bad one is bad, and the same numbers make the same ones."""

from __future__ import annotations

import json
import random
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from pytest_otmcp.conformance.requirements import generated, mcp

SCHEMAS: list[dict[str, Any]] = [
    {"type": "integer", "minimum": 0, "maximum": 65535},
    {"type": "number", "exclusiveMinimum": 0},
    {"type": "string", "minLength": 1, "maxLength": 20},
    {"type": ["string", "null"]},
    {"enum": ["a", "b"]},
    {"const": 5},
    {"anyOf": [{"type": "integer"}, {"type": "null"}]},
    {"type": "array", "items": {"type": "integer"}},
    {"type": "object", "required": ["a"], "properties": {"a": {"type": "boolean"}}},
    {"type": "boolean"},
]


@pytest.mark.parametrize("schema", SCHEMAS, ids=str)
def test_a_value_of_another_type_is_never_let_through(schema: dict[str, Any]) -> None:
    made = generated.of_other_types(random.Random(1), schema)
    assert made
    assert not any(map(Draft202012Validator(schema).is_valid, made))


@pytest.mark.parametrize("schema", SCHEMAS, ids=str)
def test_a_value_beyond_the_bounds_is_never_let_through(schema: dict[str, Any]) -> None:
    assert not any(map(Draft202012Validator(schema).is_valid, generated.beyond(random.Random(1), schema)))


def test_bounds_are_overstepped_by_one() -> None:
    assert [*generated.beyond(random.Random(1), SCHEMAS[0])] == [-1, 65536]
    assert [len(text) for text in generated.beyond(random.Random(1), SCHEMAS[2])] == [21]


@pytest.mark.parametrize("schema", SCHEMAS, ids=str)
def test_a_good_value_is_let_through(schema: dict[str, Any]) -> None:
    whole = {"type": "object", "required": ["x"], "properties": {"x": schema}}
    made = generated.good(random.Random(1), whole, {})
    assert Draft202012Validator(whole).is_valid(made)


def test_what_an_alternative_requires_is_said_to_be_required() -> None:
    whole = {
        "type": "object",
        "properties": {"target": {}, "name": {}, "names": {}, "value": {}, "other": {}},
        "required": ["target"],
        "oneOf": [
            {"properties": {"target": {"const": "one"}}, "required": ["target", "name", "value"]},
            {"$ref": "#/$defs/Several"},
        ],
        "$defs": {"Several": {"properties": {"target": {"const": "several"}}, "required": ["target", "names"]}},
    }
    assert generated.required(whole) == ["target"]
    assert generated.required_by_an_alternative(whole) == {"target", "name", "value", "names"}
    assert generated.required_by_an_alternative({"oneOf": [True, {"required": "name"}]}) == set()


def test_a_number_that_may_be_anything_may_be_a_list_of_one() -> None:
    made = generated.of_other_types(random.Random(1), {}, number=True)
    assert {type(value) for value in made} == {bool, str, type(None), list, dict}
    assert [value for value in made if isinstance(value, list)] == [[]]
    stated = generated.of_other_types(random.Random(1), {"type": "number"}, number=True)
    assert any(isinstance(value, list) and value for value in stated)


def test_references_lead_to_their_definitions() -> None:
    whole = {
        "type": "object",
        "required": ["x"],
        "properties": {"x": {"$ref": "#/$defs/Item"}},
        "$defs": {"Item": {"type": "object", "required": ["n"], "properties": {"n": {"type": "integer"}}}},
    }
    assert Draft202012Validator(whole).is_valid(generated.good(random.Random(1), whole, {}))
    assert generated.types(generated.properties(whole)["x"], whole) == {"object"}


def test_what_is_known_is_given_and_waiting_is_kept_short() -> None:
    properties = {"address": {"type": "integer"}, "wait_s": {"type": "number"}, "note": {"type": "string"}}
    made = generated.good(random.Random(1), {"type": "object", "properties": properties}, {"address": 20})
    assert made == {"address": 20, "wait_s": 1}


def test_a_number_may_be_asked_for_where_the_schema_says_nothing() -> None:
    assert generated.of_other_types(random.Random(1), {}) == []
    made = generated.of_other_types(random.Random(1), {}, number=True)
    assert True in made
    assert not any(isinstance(value, int) and not isinstance(value, bool) for value in made)


def test_the_same_numbers_make_the_same_arguments() -> None:
    first, again = (generated.of_other_types(random.Random("seed"), SCHEMAS[0]) for _ in range(2))
    assert first == again
    assert first != generated.of_other_types(random.Random("other"), SCHEMAS[0])


class Counted(dict[str, Any]):
    """A schema that counts how often it is looked at."""

    looks = 0

    def get(self, *asked: Any) -> Any:
        self.looks += 1
        return super().get(*asked)


def of(argument: Any) -> dict[str, Any]:
    """Return a schema whose argument ``x`` has this definition, which the definition itself can refer to."""
    properties = {"x": {"$ref": "#/$defs/a"}}
    return {"type": "object", "required": ["x"], "properties": properties, "$defs": {"a": argument}}


def test_alternatives_that_refer_to_each_other_end() -> None:
    alternatives = Counted(anyOf=[{"$ref": "#/$defs/a"}] * 20)
    whole = of(alternatives)
    generated.types(generated.properties(whole)["x"], whole)
    generated.good(random.Random(1), whole, {})
    assert alternatives.looks < 100_000


def test_objects_that_refer_to_each_other_end() -> None:
    names = [str(number) for number in range(20)]
    demanded = {"type": "object", "required": names, "properties": {name: {"$ref": "#/$defs/a"} for name in names}}
    assert len(json.dumps(generated.good(random.Random(1), of(demanded), {}))) < 100_000


def test_texts_and_numbers_of_any_size_are_not_made() -> None:
    schema = {"type": "object", "required": ["x"], "properties": {"x": {"type": "string", "minLength": 10**8}}}
    assert generated.good(random.Random(1), schema, {}) == {"x": "otmcp"}
    huge = {"type": "integer", "minimum": 10**4299, "maximum": 10**4300 - 1}
    assert [*generated.beyond(random.Random(1), huge)] == []
    assert generated.good(random.Random(1), {"required": ["x"], "properties": {"x": huge}}, {}) == {"x": 1}


def test_a_long_list_of_names_is_not_compared_with_itself() -> None:
    # What follows from it is a finding of the check MCP-003.
    inner = {"type": "object", "required": [*map(str, range(200)), 1]}
    assert mcp._invalid({"type": "object", "properties": {"x": inner}}) == "a list of 201 names has one that is no text"
    assert mcp._invalid({"type": "object", "properties": {"x": {"enum": [*range(200), "a"]}}}) is None


@pytest.mark.parametrize("schema", [None, [], "x", {"properties": []}, {"properties": {"x": 5}, "required": "x"}])
def test_a_schema_that_is_none_is_survived(schema: object) -> None:
    assert isinstance(generated.good(random.Random(1), schema, {}), dict)
    assert generated.required(schema) == []
