"""A tool that does nothing on the SDK's high-level server and stdio transport: the cost of a plain SDK server."""

from __future__ import annotations

from mcp.server import MCPServer
from pydantic import BaseModel

server = MCPServer("null")


class Done(BaseModel):
    """That it was done."""

    ok: bool


@server.tool()
async def null() -> Done:
    """Do nothing."""
    return Done(ok=True)


if __name__ == "__main__":
    server.run()
