"""Judges what ``tools/list`` says of a tool by what the tool is used for. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from ..core.finding import Finding

__all__ = ["listing_faults", "named_twice"]

_ELSEWHERE = ("$ref", "allOf", "anyOf", "oneOf", "patternProperties")
"""Members by which a schema may declare arguments in another place."""


def listing_faults(
    tool: str, listing: Mapping[str, object], *, arguments: Iterable[str], writes: bool, adds: bool = False
) -> Iterator[Finding]:
    """Judge the entry of one tool.

    Args:
        listing: ``inputSchema`` and ``annotations`` of its entry in ``tools/list``.
        arguments: names that it was called with.
        writes: it was called to change the plant.
        adds: what it writes takes nothing away, and does something each time.
    """
    yield from named_twice(tool, listing)
    schema = listing.get("inputSchema")
    if not isinstance(schema, Mapping) or schema.get("type") != "object":
        stated = schema.get("type") if isinstance(schema, Mapping) else schema
        yield Finding(
            code="tool_schema",
            message=f"tools/list: the inputSchema of {tool!r} should be of the type 'object', it says {stated!r}",
            requirement="MCP-003",
        )
    elif (
        not schema.get("properties") and not any(name in schema for name in _ELSEWHERE) and (names := sorted(arguments))
    ):
        # An argument that is missing among others may be the subject file's mistake.
        yield Finding(
            code="tool_schema",
            message=f"tools/list: the inputSchema of {tool!r} should declare its arguments, such as {names[0]!r}, "
            "it declares none",
            requirement="MCP-003",
        )
    annotations = listing.get("annotations")
    if writes and isinstance(annotations, Mapping):
        yield from _false_hints(tool, annotations, adds=adds)


def named_twice(tool: str, listing: Mapping[str, object]) -> Iterator[Finding]:
    """Judge that a tool has the name of another one: MCP recommends that it has not, and a client cannot know which one a call reaches."""
    twice = listing.get("twice")
    if twice == "other":
        yield Finding(
            code="tool_twice",
            message=f"tools/list: two tools that differ are called {tool!r}",
            requirement="MCP-003",
        )
    elif twice is not None:
        yield Finding(
            code="tool_twice",
            message=f"tools/list: {tool!r} should be listed once, it is listed twice",
            requirement="MCP-003",
            strength="SHOULD",
        )


def _false_hints(tool: str, annotations: Mapping[str, object], *, adds: bool) -> Iterator[Finding]:
    """Judge the annotations of a tool that writes; those that are not there have the cautious value (MCP, ToolAnnotations)."""
    if annotations.get("readOnlyHint") is True:
        yield Finding(
            code="tool_annotations",
            message=f"tools/list: {tool!r} writes, its readOnlyHint says that it does not",
            requirement="MCP-008",
        )
    elif not adds and annotations.get("destructiveHint") is False:
        yield Finding(
            code="tool_hints",
            message=f"tools/list: {tool!r} replaces what the device held, its destructiveHint should not say that it only adds",
            requirement="MCP-008",
            strength="SHOULD",
        )
    elif adds and annotations.get("idempotentHint") is True:
        yield Finding(
            code="tool_hints",
            message=f"tools/list: {tool!r} does the same again with each call, its idempotentHint should not say that it does not",
            requirement="MCP-008",
            strength="SHOULD",
        )
