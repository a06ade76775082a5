"""The bounds that a tool's own schema states."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.trial.limits import excess


def told(argument: dict[str, Any], value: object, **more: Any) -> str | None:
    return excess({"type": "object", "properties": {"a": argument}, **more}, {"a": value})


@pytest.mark.parametrize(
    ("argument", "inside", "outside"),
    [
        ({"maximum": 5}, 5, 6),
        ({"minimum": 1}, 1, 0),
        ({"exclusiveMaximum": 5}, 4.9, 5),
        ({"exclusiveMinimum": 0}, 1, 0),
        ({"maxItems": 2}, [1, 2], [1, 2, 3]),
        ({"minItems": 1}, [1], []),
        ({"maxLength": 2}, "ab", "abc"),
        ({"minLength": 1}, "a", ""),
        ({"enum": [0, 1]}, 1, 2),
        ({"enum": [0, 1]}, 0, False),
        ({"items": {"maximum": 5}}, [5, 5], [5, 6]),
        ({"items": {"properties": {"value": {"maximum": 5}}}}, [{"value": 5}], [{"value": 6}]),
        ({"anyOf": [{"type": "integer", "maximum": 5}, {"type": "null"}]}, None, 6),
        ({"oneOf": [{"type": "integer", "maximum": 5}, {"type": "string", "maxLength": 2}]}, "ab", "abc"),
        ({"anyOf": [{"maximum": 5}, {"maximum": 9}]}, 9, 10),
        ({"allOf": [{"maximum": 5}, {"minimum": 2}]}, 5, 1),
        ({"$ref": "#/$defs/Few"}, [1], [1, 2]),
    ],
)
def test_what_lies_outside_of_a_bound_is_told(argument: dict[str, Any], inside: object, outside: object) -> None:
    more = {"$defs": {"Few": {"maxItems": 1}}}
    assert told(argument, inside, **more) is None
    assert told(argument, outside, **more) is not None


def test_the_words_name_the_argument_and_the_bound() -> None:
    assert told({"maxItems": 32}, [0] * 90) == "a has the length 90, its maxItems is 32"
    assert told({"items": {"maximum": 5}}, [6]) == "a is 6, its maximum is 5"


@pytest.mark.parametrize(
    "argument", [{}, True, None, {"maximum": "5"}, {"type": "string"}, {"maximum": True}, {"$ref": 5}, {"anyOf": 7}]
)
def test_what_is_no_bound_bounds_nothing(argument: Any) -> None:
    assert told(argument, 10**9) is None


@pytest.mark.parametrize("schema", [None, 5, [], {}, {"properties": []}])
def test_what_is_no_schema_bounds_nothing(schema: object) -> None:
    assert excess(schema, {"a": 10**9}) is None


def test_a_schema_that_refers_to_itself_is_looked_at_for_a_while_only() -> None:
    itself = {"$ref": "#/$defs/A", "anyOf": [{"$ref": "#/$defs/A"}] * 50}
    assert excess({"$defs": {"A": itself}, "properties": {"a": itself}}, {"a": 1}) is None
