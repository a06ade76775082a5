"""Adapters of foreign shape: run as ``python foreign.py SHAPE [--read-only]``.

They are honest unless ``FOREIGN_LIE`` names one of the lies of their shape. What they share is only how they are served:
no envelope, no names, no addresses and no manner of failing in common, like adapters in the wild.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

import anyio
from mcp import MCPError
from mcp.server.lowlevel import Server
from mcp.server.stdio import stdio_server
from mcp.types import (
    INVALID_PARAMS,
    CallToolRequestParams,
    CallToolResult,
    ListToolsResult,
    TextContent,
    Tool,
)

SHAPES = {
    "modbus-prose": "foreign_modbus",
    "modbus-json": "foreign_modbus",
    "modbus-http": "foreign_modbus",
    "mqtt-connect": "foreign_mqtt",
    "mqtt-handle": "foreign_mqtt",
    "mqtt-collect": "foreign_mqtt",
    "opcua-items": "foreign_opcua",
}


class Failure(Exception):
    """What the device or the network said no to; ``kind`` is the adapter's own word for it."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


def prose(text: str, *, is_error: bool = False) -> CallToolResult:
    return CallToolResult(content=[TextContent(type="text", text=text)], is_error=is_error)


def json_text(document: Any) -> CallToolResult:
    return prose(json.dumps(document))


def structured(document: dict[str, Any], *, text: str | None = None, is_error: bool = False) -> CallToolResult:
    shown = json.dumps(document) if text is None else text
    content = [TextContent(type="text", text=shown)]
    return CallToolResult(content=content, structured_content=document, is_error=is_error)


def no_such_tool(name: str) -> CallToolResult:
    """What the high-level servers answer; the specification wants an error of the protocol."""
    return prose(f"Unknown tool: {name}", is_error=True)


def no_such_method(name: str) -> CallToolResult:
    """What the specification wants."""
    raise MCPError(INVALID_PARAMS, f"Unknown tool: {name}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """One adapter.

    Attributes:
        tools: name to its arguments (name to JSON type) and its handler.
        unlisted: names of tools that work, but are not listed.
        open_arguments: the schemas say that they take more than they name.
        unknown: the answer to a call of a tool that is not there.
        http: it is served over streamable HTTP.
    """

    tools: dict[str, tuple[dict[str, str], Callable[..., Awaitable[CallToolResult]]]]
    unlisted: tuple[str, ...] = ()
    open_arguments: bool = False
    unknown: Callable[[str], CallToolResult] = field(default=no_such_tool)
    http: bool = False

    def listing(self) -> ListToolsResult:
        return ListToolsResult(
            tools=[
                Tool(
                    name=name,
                    input_schema={
                        "type": "object",
                        "properties": {argument: {"type": kind} for argument, kind in arguments.items()},
                        "additionalProperties": self.open_arguments,
                    },
                )
                for name, (arguments, _) in self.tools.items()
                if name not in self.unlisted
            ]
        )

    async def call(self, name: str, given: dict[str, Any]) -> CallToolResult:
        if name not in self.tools:
            return self.unknown(name)
        known, handler = self.tools[name]
        # Like the servers of mcp 1.x: what is not known is dropped without a word.
        return await handler(**{argument: value for argument, value in given.items() if argument in known})


def server_of(shape: Shape) -> Server[Any]:
    async def list_tools(context: Any, params: Any) -> ListToolsResult:
        return shape.listing()

    async def call_tool(context: Any, params: CallToolRequestParams) -> CallToolResult:
        return await shape.call(params.name, params.arguments or {})

    return Server("foreign", version="1.0", on_list_tools=list_tools, on_call_tool=call_tool)


async def serve_stdio(server: Server[Any]) -> None:
    async with stdio_server() as (read, write):
        await server.run(read, write, server.create_initialization_options())


def main() -> None:
    name = sys.argv[1]
    build = getattr(import_module(SHAPES[name]), name.replace("-", "_"))
    shape: Shape = build(lie=os.environ.get("FOREIGN_LIE"), read_only="--read-only" in sys.argv)
    server = server_of(shape)
    if not shape.http:
        anyio.run(serve_stdio, server)
        # Without the interpreter's own end, which takes as long as everything before it.
        sys.stdout.flush()
        os._exit(0)
    import uvicorn

    port = int(os.environ["FOREIGN_HTTP_PORT"])
    uvicorn.run(server.streamable_http_app(), host="127.0.0.1", port=port, log_level="warning")


if __name__ == "__main__":
    # One module, whether it runs or is imported by the modules of the shapes.
    sys.modules["foreign"] = sys.modules["__main__"]
    main()
