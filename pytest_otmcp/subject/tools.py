"""The tools of an adapter, by what the subject file binds to them. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from ..protocols.registry import protocols
from .model import Adapter, Binding, Function

__all__ = ["bound", "only_reads", "unbound"]


def bound(adapter: Adapter, tool: str) -> list[tuple[str, Binding]]:
    """Return the operations that the subject file binds a tool to, each with its binding."""
    return [
        (operation, binding)
        for operation, bindings in adapter.operations.items()
        if isinstance(bindings, tuple)
        for binding in bindings
        if binding.tool == tool and not binding.resource
    ]


def only_reads(adapter: Adapter, tool: str) -> bool:
    """Tell whether the subject file binds a tool, and only to operations that write nothing: an annotation is the adapter's own word."""
    known = protocols()[adapter.protocol].operations
    return {known[operation].writes for operation, _ in bound(adapter, tool)} == {False}


def unbound(adapter: Adapter, tools: Iterable[str]) -> list[str]:
    """Return the tools that the subject file says nothing of, so that no run calls them; a function may call any tool."""
    if any(isinstance(bindings, Function) for bindings in adapter.operations.values()):
        return []
    starting = {one.tool for one in (adapter.connect, adapter.ready) if one is not None}
    return [tool for tool in tools if tool not in starting and not bound(adapter, tool)]
