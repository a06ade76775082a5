"""A Modbus adapter as one writes it first: the official SDK, and pymodbus's synchronous client."""

import os

from mcp.server import MCPServer
from pymodbus.client import ModbusTcpClient

mcp = MCPServer("plant-modbus")
plc = ModbusTcpClient(os.environ["MODBUS_HOST"], port=int(os.environ["MODBUS_PORT"]))


def answer_of(reply):
    if reply.isError():
        raise RuntimeError(f"Modbus error: {reply}")
    return reply


@mcp.tool()
def ping() -> bool:
    """Say whether the PLC can be reached."""
    return plc.connect()


@mcp.tool()
def read_input_registers(address: int, count: int = 1) -> list[int]:
    """Read input registers (function code 4)."""
    plc.connect()
    return answer_of(plc.read_input_registers(address, count=count)).registers


@mcp.tool()
def read_holding_registers(address: int, count: int = 1) -> list[int]:
    """Read holding registers (function code 3)."""
    plc.connect()
    return answer_of(plc.read_holding_registers(address, count=count)).registers


@mcp.tool()
def write_register(address: int, value: int) -> str:
    """Write one holding register (function code 6)."""
    if not os.environ.get("MODBUS_WRITES"):
        raise PermissionError("writing is disabled")
    plc.connect()
    answer_of(plc.write_register(address, value))
    return f"wrote {value} to register {address}"


if __name__ == "__main__":
    mcp.run()
