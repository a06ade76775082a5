"""A form made of a schema expresses what it can, and leaves the rest to JSON, whatever the schema is."""

from __future__ import annotations

from typing import Any

import pytest

from pytest_otmcp.console.form import Field, fields


def only(schema: object, **around: object) -> Field:
    """Return the field of the one argument of a tool."""
    [field] = fields({"type": "object", "properties": {"x": schema}, **around})
    return field


@pytest.mark.parametrize(
    ("schema", "kind"),
    [
        ({"type": "integer"}, "integer"),
        ({"type": "number"}, "number"),
        ({"type": "boolean"}, "boolean"),
        ({"type": "string"}, "text"),
        ({"type": ["string", "null"]}, "text"),
        ({"anyOf": [{"type": "integer"}, {"type": "null"}]}, "integer"),
        ({"enum": [1, "a", None]}, "choice"),
        ({"const": "a"}, "choice"),
        ({"type": "array", "items": {"type": "integer"}}, "json"),
        ({"type": "object"}, "json"),
        ({"anyOf": [{"type": "integer"}, {"type": "string"}]}, "json"),
        ({}, "json"),
        (True, "json"),
    ],
)
def test_each_type_has_its_way_of_being_entered(schema: object, kind: str) -> None:
    assert only(schema).kind == kind


def test_bounds_are_those_of_the_schema_and_whole_numbers_beyond_a_bound_begin_one_away() -> None:
    assert only({"type": "integer", "minimum": 0, "maximum": 65535}) == Field(
        name="x", kind="integer", required=False, lowest=0, highest=65535
    )
    beyond = {"exclusiveMinimum": 0, "exclusiveMaximum": 10}
    assert (only({"type": "integer", **beyond}).lowest, only({"type": "integer", **beyond}).highest) == (1, 9)
    assert (only({"type": "number", **beyond}).lowest, only({"type": "number", **beyond}).highest) == (None, None)
    text = only({"type": "string", "minLength": 1, "maxLength": 8})
    assert (text.shortest, text.longest) == (1, 8)


def test_required_default_description_and_choices_are_shown() -> None:
    field = only({"enum": ["a", 2], "default": "a", "description": "which"}, required=["x"])
    assert field == Field(
        name="x", kind="choice", required=True, description="which", default='"a"', choices=('"a"', "2")
    )


def test_a_reference_within_the_schema_is_followed() -> None:
    definitions = {"$defs": {"a/b": {"type": "integer", "minimum": 3, "description": "inner"}}}
    field = only({"$ref": "#/$defs/a~1b", "description": "outer"}, **definitions)
    assert (field.kind, field.lowest, field.description) == ("integer", 3, "outer")


@pytest.mark.parametrize(
    "schema",
    [
        None,
        [],
        "x",
        {"properties": []},
        {"properties": {"x": 1}, "required": "x"},
        {"properties": {"x": {"type": {}, "enum": {}, "minimum": "a", "maxLength": -1, "description": 3}}},
        {"properties": {"x": {"$ref": "#/properties/x"}}},
        {"properties": {"x": {"$ref": "#/nowhere"}}},
        {"properties": {"x": {"$ref": "http://evil.example/"}}},
        {"properties": {"x": {"anyOf": [{"oneOf": [{"$ref": "#/properties/x"}]}]}}},
        {"properties": {"x": {"type": "integer", "minimum": True, "exclusiveMinimum": False}}},
    ],
)
def test_no_schema_of_an_adapter_breaks_the_form(schema: Any) -> None:
    assert all(field.lowest is None and field.kind in ("json", "integer") for field in fields(schema))
