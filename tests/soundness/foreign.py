"""Adapters of foreign shape: run as ``python foreign.py SHAPE [--read-only]``.

They are honest unless ``FOREIGN_LIE`` names one of the lies of their shape. They share only the code that serves them:
like adapters in the wild, they have no envelope, no names, no addresses and no manner of failing in common.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

Result = dict[str, Any]
"""The result of a tool call as it is on the wire."""

INVALID_PARAMS = -32602
METHOD_NOT_FOUND = -32601

SHAPES = {
    "modbus-prose": "foreign_modbus",
    "modbus-json": "foreign_modbus",
    "modbus-http": "foreign_modbus",
    "mqtt-connect": "foreign_mqtt",
    "mqtt-handle": "foreign_mqtt",
    "mqtt-session": "foreign_mqtt",
    "mqtt-payloads": "foreign_mqtt",
    "mqtt-collect": "foreign_mqtt",
    "mqtt-wait": "foreign_mqtt",
    "opcua-items": "foreign_opcua",
    "modbus-valves": "foreign_commands",
    "opcua-brewery": "foreign_readings",
    "modbus-tank": "foreign_readings",
    "mqtt-lights": "foreign_commands",
    "mqtt-host": "foreign_sparkplug",
    "mqtt-listener": "foreign_sparkplug",
}


class Failure(Exception):
    """A failure that the adapter reports; ``kind`` is the adapter's own word for it."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


class ProtocolError(Exception):
    """An answer that is an error of the protocol, with ``code``, instead of a result."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


def prose(text: str, *, is_error: bool = False) -> Result:
    return {"content": [{"type": "text", "text": text}], "isError": is_error}


def json_text(document: Any) -> Result:
    return prose(json.dumps(document))


def structured(document: dict[str, Any], *, text: str | None = None, is_error: bool = False) -> Result:
    return prose(json.dumps(document) if text is None else text, is_error=is_error) | {"structuredContent": document}


def no_such_tool(name: str) -> Result:
    """Answer as the SDK's high-level servers do; the specification wants an error of the protocol."""
    return prose(f"Unknown tool: {name}", is_error=True)


def no_such_method(name: str) -> Result:
    """Raise an error of the protocol, as the specification wants."""
    raise ProtocolError(INVALID_PARAMS, f"Unknown tool: {name}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """The shape of one adapter.

    Attributes:
        tools: name to its arguments (name to JSON type, or to a JSON Schema) and its handler.
        unlisted: names of tools that work, but are not listed.
        open_arguments: the schemas allow arguments that they do not name.
        unknown: the answer to a call of a tool that does not exist.
        strict: every argument is required, and what the schemas do not allow is refused.
        served: ``stdio``, by a few lines of this module, because most tests are about answers and the SDK takes most of
            a second to start; ``sdk``, by the SDK over stdio; or ``http``, by the SDK over HTTP.
    """

    tools: dict[str, tuple[dict[str, Any], Callable[..., Awaitable[Result]]]]
    unlisted: tuple[str, ...] = ()
    open_arguments: bool = False
    strict: bool = False
    unknown: Callable[[str], Result] = field(default=no_such_tool)
    served: str = "stdio"

    def listing(self) -> list[dict[str, Any]]:
        return [
            {
                "name": name,
                "description": f"{name.replace('_', ' ').capitalize()}.",
                "inputSchema": self._schema(arguments),
            }
            for name, (arguments, _) in self.tools.items()
            if name not in self.unlisted
        ]

    def _schema(self, arguments: dict[str, Any]) -> dict[str, Any]:
        properties = {name: {"type": kind} if isinstance(kind, str) else kind for name, kind in arguments.items()}
        required = {"required": list(arguments)} if self.strict else {}
        return {"type": "object", "properties": properties, "additionalProperties": self.open_arguments, **required}

    async def call(self, name: str, given: dict[str, Any]) -> Result:
        if name not in self.tools:
            return self.unknown(name)
        known, handler = self.tools[name]
        if self.strict:
            from jsonschema import Draft202012Validator

            problem = next(Draft202012Validator(self._schema(known)).iter_errors(given), None)
            if problem is not None:
                return prose(f"Error: invalid arguments: {problem.message[:200]}", is_error=True)
        # As the servers of mcp 1.x do: an unknown argument is dropped without an error.
        return await handler(**{argument: value for argument, value in given.items() if argument in known})


# -- by hand ----------------------------------------------------------------------------------------------------------


async def serve_by_hand(shape: Shape) -> None:
    """Serve MCP 2025-11-25 over stdio, as far as a client needs it; calls are served at the same time."""
    reader = asyncio.StreamReader(limit=2**20)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    serving: set[asyncio.Task[None]] = set()
    while line := await reader.readline():
        try:
            message = json.loads(line)
        except ValueError:
            continue
        if isinstance(message, dict) and {"id", "method"} <= message.keys():
            task = asyncio.create_task(answer(shape, message))
            serving.add(task)
            task.add_done_callback(serving.discard)


async def answer(shape: Shape, message: dict[str, Any]) -> None:
    content: dict[str, Any]
    try:
        content = {"result": await result_of(shape, message["method"], message.get("params") or {})}
    except ProtocolError as error:
        content = {"error": {"code": error.code, "message": str(error)}}
    print(json.dumps({"jsonrpc": "2.0", "id": message["id"], **content}), flush=True)


async def result_of(shape: Shape, method: str, params: dict[str, Any]) -> dict[str, Any]:
    match method:
        case "initialize":
            about = {"name": "foreign", "version": "1.0"}
            version = params["protocolVersion"]
            return {"protocolVersion": version, "capabilities": {"tools": {}}, "serverInfo": about}
        case "tools/list":
            return {"tools": shape.listing()}
        case "tools/call":
            return await shape.call(params["name"], params.get("arguments") or {})
    raise ProtocolError(METHOD_NOT_FOUND, f"Method not found: {method}")


# -- by the SDK -------------------------------------------------------------------------------------------------------


def server_of(shape: Shape) -> Any:
    from mcp import MCPError
    from mcp.server.lowlevel import Server
    from mcp.types import CallToolResult, ListToolsResult

    async def list_tools(context: Any, params: Any) -> ListToolsResult:
        return ListToolsResult.model_validate({"tools": shape.listing()})

    async def call_tool(context: Any, params: Any) -> CallToolResult:
        try:
            return CallToolResult.model_validate(await shape.call(params.name, params.arguments or {}))
        except ProtocolError as error:
            raise MCPError(error.code, str(error)) from None

    return Server("foreign", version="1.0", on_list_tools=list_tools, on_call_tool=call_tool)


async def serve_stdio(shape: Shape) -> None:
    from mcp.server.stdio import stdio_server

    server = server_of(shape)
    async with stdio_server() as (read, write):
        await server.run(read, write, server.create_initialization_options())


def serve_http(shape: Shape) -> None:
    import uvicorn

    port = int(os.environ["FOREIGN_HTTP_PORT"])
    uvicorn.run(server_of(shape).streamable_http_app(), host="127.0.0.1", port=port, log_level="warning")


def main() -> None:
    name = sys.argv[1]
    build = getattr(import_module(SHAPES[name]), name.replace("-", "_"))
    shape: Shape = build(lie=os.environ.get("FOREIGN_LIE"), read_only="--read-only" in sys.argv)
    if shape.served == "http":
        serve_http(shape)
    else:
        asyncio.run(serve_by_hand(shape) if shape.served == "stdio" else serve_stdio(shape))


if __name__ == "__main__":
    # The modules of the shapes import ``foreign``: they must get the module that runs, not a second one.
    sys.modules["foreign"] = sys.modules["__main__"]
    main()
