"""A Modbus adapter that earns Silver: the official SDK, and pymodbus's synchronous client."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from mcp.server.mcpserver.exceptions import ToolError
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU
from strict_mcp import READS, WRITES, StrictServer, strict

mcp = StrictServer("plant-modbus", "1.0.0")

CONNECTIONS = threading.BoundedSemaphore(4)  # a PLC has room for a few

Address = strict(int, "register address, from 0", ge=0, le=65535)
Count = strict(int, "number of registers", ge=1, le=125)
Value = strict(int, "value of the register", ge=0, le=65535)


@contextmanager
def plc() -> Iterator[ModbusTcpClient]:
    """Give a call a connection of its own: an answer that comes late can be taken for no other call's."""
    # retries: pymodbus sends a request again when no answer came, a write as well.
    client = ModbusTcpClient(
        os.environ["MODBUS_HOST"],
        port=int(os.environ["MODBUS_PORT"]),
        timeout=float(os.environ.get("MODBUS_TIMEOUT_S", "2")),
        retries=0,
    )
    if not CONNECTIONS.acquire(timeout=0.5):
        raise ToolError("device_busy: too many calls at the same time; nothing was sent")
    try:
        if not client.connect():
            raise ToolError("connect_failed: the PLC cannot be reached; nothing was sent")
        yield client
    except (ModbusException, OSError) as error:
        # The SDK hides the text of every exception but ToolError.
        raise ToolError(f"no_reply: the PLC gave no valid answer ({error})") from error
    finally:
        client.close()
        CONNECTIONS.release()


def checked(reply: ModbusPDU, function: int, count: int = 1) -> ModbusPDU:
    """Return the reply; raise the text for an exception of the PLC, or for an answer to something else."""
    if reply.isError():
        raise ToolError(f"modbus exception {reply.exception_code}: the PLC refused")
    # pymodbus takes an answer of another function, or with another number of registers.
    if (reply.function_code, len(reply.registers)) != (function, count):
        raise ToolError(f"bad_reply: {len(reply.registers)} registers by function {reply.function_code}")
    return reply


@mcp.tool(annotations=READS)
def ping() -> dict[str, bool]:
    """Ask the PLC for one register, to say whether it answers."""
    with plc() as client:
        client.read_holding_registers(0)
    return {"reachable": True}


@mcp.tool(annotations=READS)
def read_input_registers(address: Address, count: Count = 1) -> dict[str, list[int]]:
    """Read input registers (function code 4)."""
    with plc() as client:
        return {"registers": checked(client.read_input_registers(address, count=count), 4, count).registers}


@mcp.tool(annotations=READS)
def read_holding_registers(address: Address, count: Count = 1) -> dict[str, list[int]]:
    """Read holding registers (function code 3)."""
    with plc() as client:
        return {"registers": checked(client.read_holding_registers(address, count=count), 3, count).registers}


@mcp.tool(annotations=WRITES)
def write_register(address: Address, value: Value) -> dict[str, int]:
    """Write one holding register (function code 6)."""
    if os.environ.get("MODBUS_WRITES") != "true":
        raise ToolError("writes_disabled: MODBUS_WRITES is not true; nothing was sent")
    with plc() as client:
        reply = checked(client.write_register(address, value), 6)
    if (reply.address, reply.registers) != (address, [value]):
        raise ToolError(f"bad_reply: the PLC answered for register {reply.address}, value {reply.registers}")
    return {"address": address, "value": value}


if __name__ == "__main__":
    mcp.run()
