"""A Modbus adapter as one writes it first: the official SDK, and pymodbus's asynchronous client."""

import os
from functools import cache

from mcp.server import MCPServer
from pymodbus.client import AsyncModbusTcpClient

mcp = MCPServer("plant-modbus")


@cache
def plc():
    return AsyncModbusTcpClient(os.environ["MODBUS_HOST"], port=int(os.environ["MODBUS_PORT"]))


async def connected():
    if not plc().connected:
        await plc().connect()
    return plc()


def answer_of(reply):
    if reply.isError():
        raise RuntimeError(f"Modbus error: {reply}")
    return reply


@mcp.tool()
async def ping() -> bool:
    """Say whether the PLC can be reached."""
    return (await connected()).connected


@mcp.tool()
async def read_input_registers(address: int, count: int = 1) -> list[int]:
    """Read input registers (function code 4)."""
    return answer_of(await (await connected()).read_input_registers(address, count=count)).registers


@mcp.tool()
async def read_holding_registers(address: int, count: int = 1) -> list[int]:
    """Read holding registers (function code 3)."""
    return answer_of(await (await connected()).read_holding_registers(address, count=count)).registers


@mcp.tool()
async def write_register(address: int, value: int) -> str:
    """Write one holding register (function code 6)."""
    if not os.environ.get("MODBUS_WRITES"):
        raise PermissionError("writing is disabled")
    answer_of(await (await connected()).write_register(address, value))
    return f"wrote {value} to register {address}"


if __name__ == "__main__":
    mcp.run()
