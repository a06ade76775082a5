"""The bounds that a tool's own ``inputSchema`` states, and arguments that lie outside of them. Pure.

A bound that is narrower than the protocol's is an author's choice: the kit asks for no more than the schema allows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeGuard

from ..core.strict_json import same_json

__all__ = ["excess"]

_DEEPEST = 8
_MOST = 2000
"""Schemas and values that are looked at for one call."""


def excess(schema: object, arguments: Mapping[str, object]) -> str | None:
    """Return in words which bound of a tool's schema the arguments do not keep; None where they keep all that are understood.

    Only bounds count: of numbers, of lengths of texts and lists, and lists of values. Types and required arguments do not.
    """
    return next(_Reading(schema).beyond(schema, arguments, "", 0), None)


class _Reading:
    """One look at a schema, which is the adapter's and may refer to itself."""

    def __init__(self, whole: object) -> None:
        self._whole = whole
        self._left = _MOST

    def beyond(self, schema: object, value: object, where: str, depth: int) -> Iterator[str]:
        self._left -= 1
        if not isinstance(schema, Mapping) or depth > _DEEPEST or self._left < 0:
            return
        yield from _of_itself(schema, value, where)
        if (name := schema.get("$ref")) is not None:
            yield from self.beyond(self._referred(name), value, where, depth + 1)
        for member in _list(schema.get("allOf")):
            yield from self.beyond(member, value, where, depth + 1)
        for word in ("anyOf", "oneOf"):
            # One alternative that lets the value through is enough.
            members = [member for member in _list(schema.get(word)) if self._may_be(member, value)]
            found = [next(self.beyond(member, value, where, depth + 1), None) for member in members]
            if found and (first := found[0]) is not None and None not in found:
                yield first
        if isinstance(value, Mapping) and isinstance(parts := schema.get("properties"), Mapping):
            for name, part in value.items():
                yield from self.beyond(parts.get(name), part, f"{where}.{name}".lstrip("."), depth + 1)
        elif isinstance(value, list) and isinstance(items := schema.get("items"), Mapping):
            for part in value:
                yield from self.beyond(items, part, where, depth + 1)

    def _may_be(self, member: object, value: object) -> bool:
        if isinstance(member, Mapping) and "$ref" in member:
            member = self._referred(member["$ref"])
        stated = member.get("type") if isinstance(member, Mapping) else None
        return not isinstance(stated, str) or stated in _types(value)

    def _referred(self, name: object) -> object:
        definitions = self._whole.get("$defs") if isinstance(self._whole, Mapping) else None
        if not isinstance(name, str) or not isinstance(definitions, Mapping):
            return None
        return definitions.get(name.removeprefix("#/$defs/"))


def _of_itself(schema: Mapping[str, Any], value: object, where: str) -> Iterator[str]:
    if _is_number(value):
        for word, sign, inclusive in (
            ("minimum", 1, True),
            ("maximum", -1, True),
            ("exclusiveMinimum", 1, False),
            ("exclusiveMaximum", -1, False),
        ):
            bound = schema.get(word)
            if _is_number(bound) and (sign * value < sign * bound or (value == bound and not inclusive)):
                yield f"{where} is {value}, its {word} is {bound}"
    for kind, least, most in ((str, "minLength", "maxLength"), (list, "minItems", "maxItems")):
        if isinstance(value, kind):
            length = len(value)
            if _is_number(bound := schema.get(least)) and length < bound:
                yield f"{where} has the length {length}, its {least} is {bound}"
            if _is_number(bound := schema.get(most)) and length > bound:
                yield f"{where} has the length {length}, its {most} is {bound}"
    if isinstance(values := schema.get("enum"), list) and not any(same_json(one, value) for one in values):
        yield f"{where} is {value!r:.80}, which is none of its values"


def _list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def _is_number(value: object) -> TypeGuard[int | float]:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _types(value: object) -> tuple[str, ...]:
    if value is None:
        return ("null",)
    if isinstance(value, bool):
        return ("boolean",)
    if isinstance(value, int) or (isinstance(value, float) and value.is_integer()):
        return ("integer", "number")
    for kind, name in ((float, "number"), (str, "string"), (list, "array")):
        if isinstance(value, kind):
            return (name,)
    return ("object",)
