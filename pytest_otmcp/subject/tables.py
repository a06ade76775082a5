"""Kinds of structured values in a subject file: tables with known keys, tables with any keys, and lists. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from .kinds import Definitions, Kind, Refusal, nearest, toml_type

__all__ = ["ByType", "Key", "ListOf", "MapOf", "Named", "Rule", "Table", "Template"]


@dataclass(frozen=True, slots=True)
class Template(Kind):
    """A table of a tool's arguments, with ``"$name"`` for an input of that name, and ``"$step.name"`` for a handle that another call keeps,
    anywhere in nested tables and lists."""

    inputs: tuple[str, ...]

    def read(self, value: object, key: str) -> Any:
        if not isinstance(value, dict):
            raise Refusal(key, f"expected a table, found {toml_type(value)}")
        self._check(value, key)
        return value

    def _check(self, value: object, key: str) -> None:
        if isinstance(value, str) and value.startswith("$") and "." not in value and value[1:] not in self.inputs:
            known = ", ".join(f"${name}" for name in self.inputs) or "none"
            raise Refusal(key, f"{value} is no input of this operation; its inputs are: {known}")
        if isinstance(value, str) and any(f"${name}" in value[1:] for name in self.inputs):
            raise Refusal(
                key,
                f"{value!r} would be sent as it is: an input stands alone, and what is composed of one takes a function (bindings)",
            )
        if isinstance(value, dict):
            for name, member in value.items():
                self._check(member, f"{key}.{name}")
        elif isinstance(value, list):
            for member in value:
                self._check(member, key)

    def schema(self, definitions: Definitions) -> dict[str, Any]:
        return {"type": "object"}


@dataclass(frozen=True, slots=True)
class MapOf(Kind):
    """A table with any keys, all of whose values are of one kind."""

    kind: Kind

    def read(self, value: object, key: str) -> Any:
        if not isinstance(value, dict):
            raise Refusal(key, f"expected a table, found {toml_type(value)}")
        return {name: self.kind.read(member, f"{key}.{name}") for name, member in value.items()}

    def schema(self, definitions: Definitions) -> dict[str, Any]:
        members = self.kind.schema(definitions)
        return {"type": "object"} | ({"additionalProperties": members} if members else {})


@dataclass(frozen=True, slots=True)
class ListOf(Kind):
    """A list of values of one kind.

    Attributes:
        expected: such a list in words.
        least: number of values that it must have at least.
    """

    kind: Kind
    expected: str
    least: int = 0

    def read(self, value: object, key: str) -> Any:
        if not isinstance(value, list) or len(value) < self.least:
            raise Refusal(key, f"expected {self.expected}, found {toml_type(value)}")
        return [self.kind.read(member, f"{key}[{index}]") for index, member in enumerate(value)]

    def schema(self, definitions: Definitions) -> dict[str, Any]:
        schema = {"type": "array", "items": self.kind.schema(definitions)}
        return schema | ({"minItems": self.least} if self.least else {})


@dataclass(frozen=True, slots=True)
class ByType(Kind):
    """A value of one kind where it has a certain Python type, else of another kind."""

    type: type
    kind: Kind
    otherwise: Kind

    def read(self, value: object, key: str) -> Any:
        return (self.kind if isinstance(value, self.type) else self.otherwise).read(value, key)

    def schema(self, definitions: Definitions) -> dict[str, Any]:
        return {"anyOf": [self.kind.schema(definitions), self.otherwise.schema(definitions)]}


@dataclass(frozen=True, slots=True)
class Named(Kind):
    """A kind that stands under a name of its own in the schema's ``$defs``."""

    name: str
    kind: Kind

    def read(self, value: object, key: str) -> Any:
        return self.kind.read(value, key)

    def schema(self, definitions: Definitions) -> dict[str, Any]:
        if self.name not in definitions:
            definitions[self.name] = self.kind.schema(definitions)
        return {"$ref": f"#/$defs/{self.name}"}


@dataclass(frozen=True, slots=True)
class Key:
    """A key of a table.

    Attributes:
        kind: of its value.
        meaning: one sentence for an author of a subject file.
        default: the value where the file lacks the key; None for no value.
        required: the file must have the key. With a default the kind's own sentence refuses its absence.
    """

    kind: Kind
    meaning: str
    default: object = None
    required: bool = False

    def schema(self, definitions: Definitions) -> dict[str, Any]:
        """Return the JSON Schema of the key's value, with its meaning and, where it is a plain value, its default."""
        schema = {**self.kind.schema(definitions), "description": self.meaning}
        return schema | ({"default": self.default} if isinstance(self.default, str | float) else {})


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """A rule about several members of one table.

    Attributes:
        holds: tells whether a table, as the file has it, keeps the rule; its members are right one by one.
        objection: the sentence when the rule does not hold.
        at: the member that the sentence is about; empty for the table.
        described: the rule in JSON Schema.
    """

    holds: Callable[[Mapping[str, object]], bool]
    objection: str
    at: str = ""
    described: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Table(Kind):
    """A table with known keys.

    Attributes:
        keys: by name.
        rules: checked in this order, after the members.
    """

    keys: Mapping[str, Key]
    rules: tuple[Rule, ...] = ()

    def read(self, value: object, key: str) -> Any:
        """Return the members in the order of the file, then the defaults of the keys that the file lacks."""
        if not isinstance(value, dict):
            raise Refusal(key, f"expected a table, found {toml_type(value)}")
        within = f"{key}." if key else ""
        for name in value:
            if name not in self.keys:
                raise Refusal(f"{within}{name}", f"unknown key; {nearest(name, self.keys)}")
        members = {}
        for name in (*value, *(name for name in self.keys if name not in value)):
            member = self.keys[name]
            found = value.get(name, member.default)
            if found is not None or member.required:
                members[name] = member.kind.read(found, f"{within}{name}")
        for rule in self.rules:
            if not rule.holds(value):
                raise Refusal(f"{within}{rule.at}" if rule.at else key, rule.objection)
        return members

    def schema(self, definitions: Definitions) -> dict[str, Any]:
        schema: dict[str, object] = {
            "type": "object",
            "properties": {name: key.schema(definitions) for name, key in self.keys.items()},
            "additionalProperties": False,
        }
        if required := [name for name, key in self.keys.items() if key.required]:
            schema["required"] = required
        if self.rules:
            schema["allOf"] = [dict(rule.described) for rule in self.rules]
        return schema
