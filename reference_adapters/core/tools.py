"""Tools as methods: :func:`tool` declares one, :func:`tools_of` collects the tools of an object."""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, TypeVar, get_type_hints

from mcp.types import Tool, ToolAnnotations

from .arguments import Arguments
from .call import Call
from .schema import input_schema, output_schema

__all__ = ["AdapterTool", "tool", "tools_of"]

Handler = Callable[[Call, Any], Awaitable[Any]]
Method = TypeVar("Method", bound=Callable[..., Awaitable[Any]])

_DECLARATION = "_tool_declaration"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Declaration:
    operation: str
    writes: bool
    idempotent: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class AdapterTool:
    """A tool that a server offers.

    Attributes:
        listing: its entry in ``tools/list``.
        model: its arguments.
        handler: the bound method that does the work.
        operation: the envelope's ``meta.operation``.
        protocol: the envelope's ``meta.protocol``.
        writes: True when it changes the state of the plant.
    """

    listing: Tool
    model: type[Arguments]
    handler: Handler
    operation: str
    protocol: str
    writes: bool


def tool(operation: str, *, writes: bool = False, idempotent: bool = True) -> Callable[[Method], Method]:
    """Declare an async method ``(self, call, arguments) -> data`` to be a tool.

    The method's name and docstring become the tool's name and description. The annotations of ``arguments`` and of the
    return value (a ``TypedDict``, or ``dict[str, Any]``) become its input and output schema.

    Args:
        operation: abstract operation, the envelope's ``meta.operation``.
        writes: the tool changes the state of the plant, so the write guard covers it.
        idempotent: calling the tool again with the same arguments has no further effect.
    """
    declaration = _Declaration(operation=operation, writes=writes, idempotent=idempotent)

    def declare(method: Method) -> Method:
        setattr(method, _DECLARATION, declaration)
        return method

    return declare


def tools_of(group: object, protocol: str) -> list[AdapterTool]:
    """Return the tools of an object in the order of their definition, those of base classes first.

    Args:
        group: the object whose methods are declared by :func:`tool`.
        protocol: the envelope's ``meta.protocol`` of these tools.
    """
    members = {name: member for cls in reversed(type(group).__mro__) for name, member in vars(cls).items()}
    return [
        _adapter_tool(getattr(group, name), getattr(member, _DECLARATION), protocol)
        for name, member in members.items()
        if hasattr(member, _DECLARATION)
    ]


def _adapter_tool(method: Handler, declaration: _Declaration, protocol: str) -> AdapterTool:
    hints = get_type_hints(method)
    annotations = ToolAnnotations(
        read_only_hint=not declaration.writes,
        destructive_hint=declaration.writes,
        idempotent_hint=declaration.idempotent,
        open_world_hint=False,
    )
    listing = Tool(
        name=method.__name__,
        description=inspect.cleandoc(method.__doc__ or ""),
        input_schema=input_schema(hints["arguments"]),
        output_schema=output_schema(hints["return"]),
        annotations=annotations,
    )
    return AdapterTool(
        listing=listing,
        model=hints["arguments"],
        handler=method,
        operation=declaration.operation,
        protocol=protocol,
        writes=declaration.writes,
    )
