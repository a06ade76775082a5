"""The MCP SDK for an adapter whose arguments move a plant: strict arguments, unknown ones refused, texts that hide nothing.

The SDK turns "5" and true into numbers unless a parameter is strict, drops arguments that a tool does not have, answers an unknown tool
with a result, and shows the texts of a device as they are. Copy this file beside your adapter.
"""

from __future__ import annotations

import json
from typing import Annotated, Any

from mcp import MCPError
from mcp.server import MCPServer
from mcp.types import CallToolResult, TextContent, ToolAnnotations
from pydantic import Field

__all__ = ["READS", "SENDS", "WRITES", "StrictServer", "strict"]

READS = ToolAnnotations(read_only_hint=True, open_world_hint=False)
WRITES = ToolAnnotations(read_only_hint=False, destructive_hint=True, idempotent_hint=True, open_world_hint=False)
SENDS = WRITES.model_copy(update={"idempotent_hint": False})  # a message, which is another one with each call

_INVALID_PARAMS = -32602


def strict(kind: Any, description: str, **limits: Any) -> Any:
    """Return the annotation of a parameter that takes this JSON type alone, within these limits."""
    return Annotated[kind, Field(strict=True, description=description, **limits)]


def shown(text: str) -> str:
    """Return a text without characters that steer a terminal or hide something from a reader: escaped as in JSON, which means the same there."""
    return "".join(one if one.isprintable() or one in "\n\t" else json.dumps(one)[1:-1] for one in text)


class StrictServer(MCPServer):
    """An ``MCPServer`` that takes the arguments that its tools declare, and no others."""

    def __init__(self, name: str, version: str, **settings: Any) -> None:
        super().__init__(name, version=version, log_level="WARNING", middleware=[self._checked], **settings)

    async def list_tools(self) -> list[Any]:
        """Return the tools; their schemas say that there are no further arguments."""
        tools = await super().list_tools()
        for tool in tools:
            tool.input_schema["additionalProperties"] = False
        return tools

    async def _checked(self, ctx: Any, call_next: Any) -> Any:
        if ctx.method != "tools/call":
            return await call_next(ctx)
        asked = ctx.params or {}
        tools = {tool.name: tool.input_schema["properties"] for tool in await self.list_tools()}
        if (name := asked.get("name")) not in tools:
            raise MCPError(_INVALID_PARAMS, f"Unknown tool: {name}")
        if unknown := sorted(set(asked.get("arguments") or {}) - set(tools[name])):
            text = TextContent(type="text", text=f"invalid_argument: {name} has no argument {', '.join(unknown)}")
            return CallToolResult(content=[text], is_error=True, result_type="complete")
        result = await call_next(ctx)
        for block in result.get("content", []):
            if block["type"] == "text":
                block["text"] = shown(block["text"])
        return result
