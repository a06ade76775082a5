"""The reading of a tool's input schema as far as a guess needs it: properties, types, choices. Pure.

A schema comes from the adapter: what is not where it belongs counts as not there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

__all__ = ["choice", "kinds", "properties", "required", "resolved"]

_DEEPEST = 10
_MOST_PARTS = 20_000
"""Parts of a schema with its references replaced: one that refers to itself in many places has no end."""


def resolved(tool: Mapping[str, Any], chosen: re.Pattern[str] | None) -> Mapping[str, Any]:
    """Return the input schema of a tool without local references.

    Args:
        chosen: of several alternatives (``oneOf``) that differ in the value of one argument, the one whose value matches.
    """
    schema = _table(tool.get("inputSchema"))
    definitions = _table(schema.get("$defs"))
    whole = _Resolution(definitions).of({key: member for key, member in schema.items() if key != "$defs"})
    for alternative in map(_table, _list(_table(whole).get("oneOf"))):
        if any(choice(value, chosen) is not None for value in properties(alternative).values()):
            return alternative
    return _table(whole)


def properties(schema: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the schema of every argument by name."""
    # `true` is a schema as well: anything fits it.
    return {name: _table(value) for name, value in _table(schema.get("properties")).items()}


def required(schema: Mapping[str, Any]) -> list[str]:
    """Return the names of the arguments that the tool requires."""
    return [name for name in _list(schema.get("required")) if isinstance(name, str)]


def kinds(schema: Mapping[str, Any]) -> set[str]:
    """Return the types of JSON that an argument may have, without null."""
    kind = schema.get("type")
    if isinstance(kind, str):
        return {kind}
    if isinstance(kind, list):
        return {entry for entry in kind if isinstance(entry, str) and entry != "null"}
    alternatives = _list(schema.get("anyOf")) or _list(schema.get("oneOf"))
    return {kind for alternative in alternatives for kind in kinds(_table(alternative)) - {"null"}}


def choice(schema: Mapping[str, Any], chosen: re.Pattern[str] | None) -> str | None:
    """Find the value of an enumerated argument that matches, such as the name of a table."""
    if chosen is None:
        return None
    alternatives = (schema, *map(_table, _list(schema.get("anyOf"))))
    values = (value for entry in alternatives for value in (*_list(entry.get("enum")), entry.get("const")))
    return next((value for value in values if isinstance(value, str) and chosen.search(value)), None)


class _Resolution:
    """The replacement of local references, down to the depth to which tools nest arguments, and to the size that a person could read."""

    def __init__(self, definitions: Mapping[str, object]) -> None:
        self._definitions = definitions
        self._left = _MOST_PARTS

    def of(self, value: object, depth: int = 0) -> object:
        self._left -= 1
        if depth > _DEEPEST or self._left < 0:
            return {}
        if isinstance(value, Mapping):
            reference = value.get("$ref")
            if isinstance(reference, str) and reference.startswith("#/$defs/"):
                return self.of(self._definitions.get(reference.removeprefix("#/$defs/"), {}), depth + 1)
            return {name: self.of(member, depth + 1) for name, member in value.items()}
        if isinstance(value, list):
            return [self.of(element, depth + 1) for element in value]
        return value


def _table(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []
