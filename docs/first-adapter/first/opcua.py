"""An OPC UA adapter as one writes it first: the official SDK, and asyncua."""

import os
from contextlib import asynccontextmanager
from typing import Any

from asyncua import Client
from mcp.server import MCPServer

plc = Client(os.environ["OPCUA_URL"])


@asynccontextmanager
async def connected(server):
    async with plc:
        yield


mcp = MCPServer("plant-opcua", lifespan=connected)


@mcp.tool()
async def read_node(node_id: str) -> dict[str, Any]:
    """Read the value of a node."""
    return {"value": await plc.get_node(node_id).read_value()}


@mcp.tool()
async def browse_node(node_id: str) -> list[dict[str, str]]:
    """List the children of a node."""
    children = await plc.get_node(node_id).get_children()
    return [{"node_id": child.nodeid.to_string(), "name": (await child.read_browse_name()).Name} for child in children]


@mcp.tool()
async def write_node(node_id: str, value: Any) -> str:
    """Write the value of a node."""
    if not os.environ.get("OPCUA_WRITES"):
        raise PermissionError("writing is disabled")
    await plc.get_node(node_id).write_value(value)
    return f"wrote {value} to {node_id}"


if __name__ == "__main__":
    mcp.run()
