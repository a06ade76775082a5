"""A form made of a tool's input schema. Pure.

A schema is the adapter's word, of any shape. What a form cannot express gets a field for JSON, so every tool can be called.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

__all__ = ["Field", "fields"]

_DEEPEST = 16
"""References and alternatives that are followed; one may lead to itself."""

_LOCAL = "#/"


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One argument of a tool.

    Attributes:
        kind: how its value is entered; ``json`` takes any JSON value.
        required: a call without it breaks the schema.
        description: the adapter's words.
        default: what the schema says a call without it means, as JSON; empty without one.
        choices: the values that it may have, as JSON; empty where they are not listed.
        lowest, highest: bounds of a number.
        shortest, longest: characters of a text.
    """

    name: str
    kind: Literal["integer", "number", "boolean", "choice", "text", "json"]
    required: bool
    description: str = ""
    default: str = ""
    choices: tuple[str, ...] = ()
    lowest: float | None = None
    highest: float | None = None
    shortest: int | None = None
    longest: int | None = None


def fields(schema: object) -> list[Field]:
    """Return the fields of a tool's ``inputSchema``, in its order; none for a schema that names no arguments."""
    root = _object(schema)
    required = root.get("required")
    needed = required if isinstance(required, list) else []
    return [_field(name, one, root, required=name in needed) for name, one in _object(root.get("properties")).items()]


def _field(name: str, schema: object, root: Mapping[str, Any], *, required: bool) -> Field:
    outer, inner = _object(schema), _resolved(schema, root)
    choices = _choices(inner)
    kind = _kind(inner, choices)
    described = outer.get("description", inner.get("description"))
    default = outer.get("default", inner.get("default"))
    whole = kind == "integer"
    return Field(
        name=name,
        kind=kind,
        required=required,
        description=described if isinstance(described, str) else "",
        default="" if default is None else json.dumps(default, ensure_ascii=False),
        choices=choices,
        lowest=_number(inner.get("minimum"), inner.get("exclusiveMinimum"), 1 if whole else None),
        highest=_number(inner.get("maximum"), inner.get("exclusiveMaximum"), -1 if whole else None),
        shortest=_length(inner.get("minLength")),
        longest=_length(inner.get("maxLength")),
    )


def _kind(
    schema: Mapping[str, Any], choices: tuple[str, ...]
) -> Literal["integer", "number", "boolean", "choice", "text", "json"]:
    if choices:
        return "choice"
    match schema.get("type"):
        case "integer":
            return "integer"
        case "number":
            return "number"
        case "boolean":
            return "boolean"
        case "string":
            return "text"
    return "json"


def _choices(schema: Mapping[str, Any]) -> tuple[str, ...]:
    if "const" in schema:
        return (json.dumps(schema["const"], ensure_ascii=False),)
    listed = schema.get("enum")
    return tuple(json.dumps(value, ensure_ascii=False) for value in listed) if isinstance(listed, list) else ()


def _resolved(schema: object, root: Mapping[str, Any]) -> Mapping[str, Any]:
    """Follow references within the schema, and alternatives of which all but one are null."""
    for _ in range(_DEEPEST):
        here = _object(schema)
        others = [
            one for key in ("anyOf", "oneOf") for one in _list(here.get(key)) if _object(one).get("type") != "null"
        ]
        reference = here.get("$ref")
        if isinstance(reference, str) and reference.startswith(_LOCAL):
            schema = _at(root, reference.removeprefix(_LOCAL).split("/"))
        elif len(others) == 1:
            schema = others[0]
        else:
            kinds = [kind for kind in _list(here.get("type")) if kind != "null"]
            return {**here, "type": kinds[0]} if len(kinds) == 1 else here
    return {}


def _at(root: Mapping[str, Any], steps: list[str]) -> object:
    found: object = root
    for step in steps:
        found = _object(found).get(step.replace("~1", "/").replace("~0", "~"))
    return found


def _number(bound: object, beyond: object, step: int | None) -> float | None:
    """Return a bound; one that is beyond the values is a step away for whole numbers, and cannot be said of others."""
    if isinstance(bound, int | float) and not isinstance(bound, bool):
        return bound
    if step is not None and isinstance(beyond, int | float) and not isinstance(beyond, bool):
        return beyond + step
    return None


def _length(bound: object) -> int | None:
    return bound if isinstance(bound, int) and not isinstance(bound, bool) and bound >= 0 else None


def _object(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []
