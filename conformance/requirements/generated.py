"""Arguments made from a tool's own JSON Schema: good ones, and each kind of bad ones. Pure.

The generator is ours and small: a library's makes other values in its next version, and then no stored run could be judged again.
Every random choice comes from the repetition's numbers.
"""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from typing import Any, TypeGuard

__all__ = ["beyond", "good", "of_other_types", "properties", "required", "required_by_an_alternative", "types"]

_DEEPEST = 5
_MOST = 1000
"""Schemas that are looked at for the arguments of one call: a hundred alternatives that each refer to all of them are ten thousand
millions."""
_LONGEST = 10_000
_LARGEST = 2**53
"""Integers beyond it are not the same number to every reader of JSON (RFC 8259, section 6)."""
_ANY = frozenset({"boolean", "number", "string", "null", "array", "object"})
_WAITING = ("timeout", "wait", "second", "duration", "delay", "interval")
"""Parts of the names of arguments that say how long a call may take."""


def properties(schema: object) -> Mapping[str, Any]:
    """Return the schemas of the arguments that a tool's ``inputSchema`` names at its top."""
    found = schema.get("properties") if isinstance(schema, Mapping) else None
    return found if isinstance(found, Mapping) else {}


def required(schema: object) -> list[str]:
    """Return the names of the arguments that a tool's ``inputSchema`` requires."""
    found = schema.get("required") if isinstance(schema, Mapping) else None
    return [name for name in found if isinstance(name, str)] if isinstance(found, list) else []


def required_by_an_alternative(schema: object) -> set[str]:
    """Return the names of the arguments that a tool's ``inputSchema`` requires in one of its alternatives, such as a mode of the tool."""
    found: set[str] = set()
    for word in ("oneOf", "anyOf", "allOf"):
        members = schema.get(word) if isinstance(schema, Mapping) else None
        for member in members[:_MOST] if isinstance(members, list) else ():
            resolved = _resolved(member, schema) if isinstance(member, Mapping) else member
            found |= {*required(resolved), *required(resolved.get("then") if isinstance(resolved, Mapping) else None)}
    return found


class _Bounds:
    """The bounds of what is looked at of an adapter's schema, which may refer to itself: how deep, and how many schemas."""

    def __init__(self) -> None:
        self._left = _MOST

    def hold(self, depth: int) -> bool:
        """Take one schema at this depth; return whether it lies within the bounds."""
        self._left -= 1
        return depth <= _DEEPEST and self._left >= 0


def types(argument: object, whole: object = None) -> frozenset[str]:
    """Return the JSON types that a schema lets through; an ``integer`` counts as a ``number``.

    Args:
        argument: the schema.
        whole: the schema that it is a part of, where its references lead.
    """
    return _types(argument, whole, 0, _Bounds())


def _types(argument: object, whole: object, depth: int, bounds: _Bounds) -> frozenset[str]:
    if not isinstance(argument, Mapping) or not bounds.hold(depth):
        return _ANY
    argument = _resolved(argument, whole)
    stated = argument.get("type")
    if isinstance(stated, str | list):
        names = [stated] if isinstance(stated, str) else stated
        return frozenset("number" if name == "integer" else str(name) for name in names) & _ANY
    if isinstance(values := argument.get("enum"), list):
        return frozenset(map(_type, values))
    if "const" in argument:
        return frozenset({_type(argument["const"])})
    for word in ("anyOf", "oneOf"):
        if isinstance(members := argument.get(word), list) and members:
            return frozenset().union(*(_types(member, whole, depth + 1, bounds) for member in members))
    return _ANY


def of_other_types(
    rng: random.Random, argument: object, whole: object = None, *, number: bool = False, good: object = None
) -> list[Any]:
    """Return values of every JSON type that an argument does not have; of texts, those that look like its values.

    Args:
        number: the argument has to be a number, though its schema may let everything through.
        good: a good value, if one is known: where the schema states no bounds, a text of it is refused for its type alone.
    """
    allowed = types(argument, whole)
    digits = rng.randrange(2, 100)
    bounded = isinstance(argument, Mapping) and not {"minimum", "maximum"}.isdisjoint(argument)
    text = str(good) if _is_number(good) and not bounded else str(digits)
    values = [True, text, "nan", "Infinity", None, [], [digits], {}, {"value": digits}, digits]
    if allowed >= _ANY and number:
        allowed = frozenset({"number"})
        # A list of one number is the value of one element to a tool that also writes several elements of an array.
        values.remove([digits])
    return [value for value in values if _type(value) not in allowed]


def beyond(rng: random.Random, argument: object) -> Iterator[Any]:
    """Return values of the right type just outside what the schema of an argument states."""
    if not isinstance(argument, Mapping):
        return
    for word, step in (("minimum", -1), ("maximum", 1), ("exclusiveMinimum", 0), ("exclusiveMaximum", 0)):
        bound = argument.get(word)
        if _is_number(bound):
            yield bound + step
    if types(argument) == {"string"}:
        if isinstance(argument.get("enum"), list):
            yield f"otmcp-{rng.getrandbits(32):08x}"
        longest = argument.get("maxLength")
        if isinstance(longest, int) and not isinstance(longest, bool) and 0 <= longest < _LONGEST:
            yield "x" * (longest + 1)


def good(rng: random.Random, schema: object, known: Mapping[str, Any]) -> dict[str, Any]:
    """Return arguments that a tool's ``inputSchema`` lets through, as far as it says.

    Args:
        known: values for arguments with these names, which mean something to the device.
    """
    asked = set(required(schema))
    bounds = _Bounds()
    found = {}
    for name, argument in properties(schema).items():
        if name in asked or name in known:
            found[name] = known[name] if name in known else _value(argument, schema, 0, bounds)
        elif any(part in name.lower() for part in _WAITING) and "number" in _types(argument, schema, 0, bounds):
            # A call that may wait is to wait for the shortest time.
            found[name] = _value(argument, schema, 0, bounds)
    return found


def _value(argument: object, whole: object, depth: int, bounds: _Bounds) -> Any:
    if not isinstance(argument, Mapping) or not bounds.hold(depth):
        return 1
    argument = _resolved(argument, whole)
    if isinstance(values := argument.get("enum"), list) and values:
        return values[0]
    if "const" in argument:
        return argument["const"]
    for word in ("anyOf", "oneOf"):
        if isinstance(members := argument.get(word), list) and members:
            return _value(members[0], whole, depth + 1, bounds)
    allowed = types(argument, whole)
    if "number" in allowed:
        lowest = argument.get("minimum", argument.get("exclusiveMinimum", 0))
        return lowest + 1 if isinstance(lowest, int) and _is_number(lowest) else 1
    if "string" in allowed:
        shortest = argument.get("minLength")
        return "otmcp".ljust(shortest if isinstance(shortest, int) and shortest < _LONGEST else 0, "x")
    if "array" in allowed:
        return [_value(argument.get("items"), whole, depth + 1, bounds)]
    if "object" in allowed:
        parts = properties(argument)
        return {name: _value(parts.get(name), whole, depth + 1, bounds) for name in required(argument)}
    return False if "boolean" in allowed else None


def _is_number(bound: object) -> TypeGuard[int | float]:
    return isinstance(bound, int | float) and not isinstance(bound, bool) and abs(bound) <= _LARGEST


def _resolved(argument: Mapping[str, Any], whole: object) -> Mapping[str, Any]:
    name = argument.get("$ref")
    definitions = whole.get("$defs") if isinstance(whole, Mapping) else None
    if isinstance(name, str) and name.startswith("#/$defs/") and isinstance(definitions, Mapping):
        found = definitions.get(name.removeprefix("#/$defs/"))
        return found if isinstance(found, Mapping) else {}
    return argument


def _type(value: object) -> str:
    if isinstance(value, bool):
        return "boolean"
    if isinstance(value, int | float):
        return "number"
    if isinstance(value, str):
        return "string"
    if value is None:
        return "null"
    return "array" if isinstance(value, list) else "object"
