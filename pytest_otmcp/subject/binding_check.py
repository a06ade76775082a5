"""Comparison of a subject's bindings with the tools that its adapter really lists. Pure.

One SDK refuses a misspelt argument, another drops it silently: then the wrong register would be tested, and the result
would be reported as a finding.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from typing import Any

from .claims import Claims
from .model import Adapter

__all__ = ["check_bindings"]


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
                found += _compare(where, binding.tool, binding.arguments, tools)
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
        listed = ", ".join(sorted(tools)) or "none at all"
        yield f"{where}.tool: the adapter lists no tool {tool!r}; " + (
            f"did you mean {near[0]!r}?" if near else f"it lists {listed}"
        )
        return
    schema = tools[tool].get("inputSchema") or {}
    properties = schema.get("properties") or {}
    for argument in arguments:
        if argument not in properties and not _is_open(schema):
            near = difflib.get_close_matches(argument, properties, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"it takes {', '.join(properties) or 'none'}"
            yield f"{where}.arguments.{argument}: the tool {tool!r} has no such argument; {hint}"
    for argument in schema.get("required") or []:
        if argument not in arguments:
            yield f"{where}.arguments: the tool {tool!r} requires {argument!r}"


def _is_open(schema: Mapping[str, object]) -> bool:
    """Tell whether a tool takes more arguments than its schema names, or the schema names none at all."""
    extra = schema.get("additionalProperties")
    return (
        extra is True
        or isinstance(extra, dict)
        or "properties" not in schema
        or any(name in schema for name in ("anyOf", "oneOf", "allOf", "patternProperties", "$ref"))
    )
