"""The reading of a tool's input schema as far as a guess needs it: properties, types, choices. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

__all__ = ["choice", "kinds", "properties", "required", "resolved"]


def resolved(tool: Mapping[str, Any], chosen: re.Pattern[str] | None) -> Mapping[str, Any]:
    """Return the input schema of a tool without local references.

    Args:
        chosen: of several alternatives (``oneOf``) that differ in the value of one argument, the one whose value matches.
    """
    schema = tool.get("inputSchema") or {}
    whole = _resolved({key: member for key, member in schema.items() if key != "$defs"}, schema.get("$defs") or {}, 0)
    if not isinstance(whole, dict):
        return {}
    for alternative in whole.get("oneOf") or []:
        if isinstance(alternative, dict) and any(
            choice(value, chosen) is not None for value in (alternative.get("properties") or {}).values()
        ):
            return alternative
    return whole


def properties(schema: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the schema of every argument by name."""
    found = schema.get("properties") or {}
    return found if isinstance(found, dict) else {}


def required(schema: Mapping[str, Any]) -> list[str]:
    """Return the names of the arguments that the tool requires."""
    return [str(name) for name in schema.get("required") or []]


def kinds(schema: Mapping[str, Any]) -> set[str]:
    """Return the types of JSON that an argument may have, without null."""
    kind = schema.get("type")
    if isinstance(kind, str):
        return {kind}
    if isinstance(kind, list):
        return {entry for entry in kind if entry != "null"}
    return {
        kind
        for alternative in schema.get("anyOf") or schema.get("oneOf") or []
        if isinstance(alternative, dict)
        for kind in kinds(alternative) - {"null"}
    }


def choice(schema: Mapping[str, Any], chosen: re.Pattern[str] | None) -> str | None:
    """Find the value of an enumerated argument that matches, such as the name of a table."""
    if chosen is None or not isinstance(schema, Mapping):
        return None
    alternatives = (schema, *(entry for entry in schema.get("anyOf") or [] if isinstance(entry, dict)))
    values = (value for entry in alternatives for value in (*(entry.get("enum") or []), entry.get("const")))
    return next((value for value in values if isinstance(value, str) and chosen.search(value)), None)


def _resolved(value: object, definitions: Mapping[str, object], depth: int) -> object:
    """Replace the local references of a schema, down to the depth to which tools nest arguments."""
    if depth > 10:
        return value
    if isinstance(value, Mapping):
        reference = value.get("$ref")
        if isinstance(reference, str) and reference.startswith("#/$defs/"):
            return _resolved(definitions.get(reference.removeprefix("#/$defs/"), {}), definitions, depth + 1)
        return {name: _resolved(member, definitions, depth + 1) for name, member in value.items()}
    if isinstance(value, list):
        return [_resolved(element, definitions, depth + 1) for element in value]
    return value
