"""Comparison of a subject's bindings with the tools that its adapter really lists. Pure.

One SDK refuses a misspelt argument, another drops it silently: then the wrong register would be tested, and the result
would be reported as a finding.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ..core.tool_entry import TWICE
from ..protocols.protocol import Operation
from ..protocols.registry import protocols
from .addressing import mentions_address
from .claims import Claims
from .model import Adapter, handles, placeholders

__all__ = ["check_bindings"]

_SHOWN = 40
_LONGEST = 80


def check_bindings(adapter: Adapter, tools: Mapping[str, Mapping[str, object]]) -> list[str]:
    """Return the contradictions between the bindings and ``tools`` (name to entry in ``tools/list``), a sentence each."""
    found: list[str] = []
    claims = Claims.of_subject({adapter.protocol: adapter})
    for name, bound in adapter.operations.items():
        if isinstance(bound, tuple) and claims.has(f"{adapter.protocol}.{name}"):
            for index, binding in enumerate(bound):
                if binding.resource:
                    continue
                where = f"adapter.{adapter.protocol}.bind.{name}" + (f"[{index}]" if len(bound) > 1 else "")
                if binding.command is not None:
                    where = f"adapter.{adapter.protocol}.{binding.command.table}.{binding.command.name}"
                found += _compare(where, binding.tool, binding.arguments, tools)
                # Of several bindings another one may be for the calls that do not give the input.
                if len(bound) == 1:
                    asked = protocols()[adapter.protocol].operations[name]
                    found += _left_out(where, asked, binding.tool, binding.arguments, tools)
    if adapter.connect is not None:
        where = f"adapter.{adapter.protocol}.connect"
        found += _compare(where, adapter.connect.tool, adapter.connect.arguments, tools)
    return found


def _compare(
    where: str,
    tool: str,
    arguments: Mapping[str, Any],
    tools: Mapping[str, Mapping[str, Any]],
) -> Iterator[str]:
    if tool not in tools:
        near = difflib.get_close_matches(tool, tools, 1)
        more = f" and {len(tools) - _SHOWN} more" if len(tools) > _SHOWN else ""
        listed = ", ".join(name[:_LONGEST] for name in sorted(tools)[:_SHOWN]) + more or "none at all"
        yield f"{where}.tool: the adapter lists no tool {tool!r}; " + (
            f"did you mean {near[0]!r}?" if near else f"it lists {listed}"
        )
        return
    if TWICE in tools[tool]:
        # Which of its entries the subject file is about, nobody knows; that there are two is the adapter's fault, and a finding.
        return
    schema = tools[tool].get("inputSchema") or {}
    properties = schema.get("properties") or {}
    if not isinstance(properties, Mapping) or not isinstance(schema.get("required") or [], list):
        # That it is no JSON Schema is the adapter's fault as well.
        return
    for argument in arguments:
        if argument not in properties and not _is_open(schema):
            near = difflib.get_close_matches(argument, properties, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"it takes {', '.join(properties) or 'none'}"
            yield f"{where}.arguments.{argument}: the tool {tool!r} has no such argument; {hint}"
    for argument, value in arguments.items():
        if (
            not (placeholders(value) or handles(value))
            and not mentions_address(value)
            and (problem := _misfit(value, properties.get(argument)))
        ):
            yield f"{where}.arguments.{argument}: {problem}"
        elif isinstance(value, str) and value == "{port}" and _type_of(properties.get(argument)) == "integer":
            yield f'{where}.arguments.{argument}: the tool {tool!r} takes an integer; say "{{port:int}}"'
    for argument in schema.get("required") or []:
        if argument not in arguments:
            yield f"{where}.arguments: the tool {tool!r} requires {argument!r}"


def _left_out(
    where: str, asked: Operation, tool: str, arguments: Mapping[str, Any], tools: Mapping[str, Mapping[str, Any]]
) -> Iterator[str]:
    """Yield the arguments that a tool requires and that stand for an input which most calls do not give."""
    required = (tools.get(tool, {}).get("inputSchema") or {}).get("required") or []
    if not isinstance(required, list):
        return
    free = {f"${name}": name for name in asked.voluntary_inputs if name not in asked.defaults}
    for argument, value in arguments.items():
        if argument in required and isinstance(value, str) and value in free:
            yield (
                f"{where}.arguments.{argument}: the tool {tool!r} requires it, and {value} is left out where no {free[value]} is asked for; "
                "give the value that the mock device has, such as 1"
            )


def _type_of(schema: object) -> object:
    return schema.get("type") if isinstance(schema, Mapping) else None


def _misfit(value: object, schema: object) -> str | None:
    """Say how a constant contradicts the type that the tool's schema names; None where it does not, or nothing is named."""
    wanted = _type_of(schema)
    fits = _JSON_TYPES.get(str(wanted))
    if fits is None or fits(value):
        return None
    return f"the tool takes {wanted}, the subject file gives {value!r}"


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


_JSON_TYPES: Mapping[str, Callable[[object], bool]] = {
    "string": lambda value: isinstance(value, str),
    "boolean": lambda value: isinstance(value, bool),
    "number": _is_number,
    "integer": lambda value: _is_number(value) and float(str(value)).is_integer(),
    "array": lambda value: isinstance(value, list),
    "object": lambda value: isinstance(value, Mapping),
}


def _is_open(schema: Mapping[str, object]) -> bool:
    """Tell whether a tool takes more arguments than its schema names, or the schema names none at all."""
    extra = schema.get("additionalProperties")
    return (
        extra is True
        or isinstance(extra, dict)
        or "properties" not in schema
        or any(name in schema for name in ("anyOf", "oneOf", "allOf", "patternProperties", "$ref"))
    )
