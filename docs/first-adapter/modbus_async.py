"""A Modbus adapter that earns Silver: the official SDK, and pymodbus's asynchronous client."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from mcp.server.mcpserver.exceptions import ToolError
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU
from strict_mcp import READS, WRITES, StrictServer, strict

mcp = StrictServer("plant-modbus", "1.0.0")

TIMEOUT_S = float(os.environ.get("MODBUS_TIMEOUT_S", "2"))
CONNECTIONS = asyncio.Semaphore(4)  # a PLC has room for a few

Address = strict(int, "register address, from 0", ge=0, le=65535)
Count = strict(int, "number of registers", ge=1, le=125)
Value = strict(int, "value of the register", ge=0, le=65535)


@asynccontextmanager
async def waited() -> AsyncIterator[None]:
    """Wait a moment for one of the connections; refuse the call when there are too many."""
    try:
        async with asyncio.timeout(0.5):
            await CONNECTIONS.acquire()
    except TimeoutError:
        raise ToolError("device_busy: too many calls at the same time; nothing was sent") from None
    try:
        yield
    finally:
        CONNECTIONS.release()


@asynccontextmanager
async def plc() -> AsyncIterator[AsyncModbusTcpClient]:
    """Give a call a connection of its own: an answer that comes late can be taken for no other call's."""
    try:
        async with waited(), asyncio.timeout(1.5 * TIMEOUT_S) as limit:
            # pymodbus waits for its whole time-out when the connection is lost, so the loss ends the call.
            client = AsyncModbusTcpClient(
                os.environ["MODBUS_HOST"],
                port=int(os.environ["MODBUS_PORT"]),
                timeout=TIMEOUT_S,
                retries=0,  # pymodbus sends a request again when no answer came, a write as well.
                reconnect_delay=0,
                trace_connect=lambda connected: None if connected else limit.reschedule(0),
            )
            try:
                if not await client.connect():
                    raise ToolError("connect_failed: the PLC cannot be reached; nothing was sent")
                yield client
            finally:
                client.close()
    except (ModbusException, OSError) as error:
        # The SDK hides the text of every exception but ToolError.
        raise ToolError(f"no_reply: the PLC gave no valid answer ({error})") from error


def checked(reply: ModbusPDU, function: int, count: int = 1) -> ModbusPDU:
    """Return the reply; raise the text for an exception of the PLC, or for an answer to something else."""
    # The asynchronous client takes an answer with the transaction identifier 0 for any request.
    if not reply.transaction_id:
        raise ToolError("bad_reply: the answer is to another request")
    if reply.isError():
        raise ToolError(f"modbus exception {reply.exception_code}: the PLC refused")
    # pymodbus takes an answer of another function, or with another number of registers.
    if (reply.function_code, len(reply.registers)) != (function, count):
        raise ToolError(f"bad_reply: {len(reply.registers)} registers by function {reply.function_code}")
    return reply


@mcp.tool(annotations=READS)
async def ping() -> dict[str, bool]:
    """Ask the PLC for one register, to say whether it answers."""
    async with plc() as client:
        await client.read_holding_registers(0)
    return {"reachable": True}


@mcp.tool(annotations=READS)
async def read_input_registers(address: Address, count: Count = 1) -> dict[str, list[int]]:
    """Read input registers (function code 4)."""
    async with plc() as client:
        return {"registers": checked(await client.read_input_registers(address, count=count), 4, count).registers}


@mcp.tool(annotations=READS)
async def read_holding_registers(address: Address, count: Count = 1) -> dict[str, list[int]]:
    """Read holding registers (function code 3)."""
    async with plc() as client:
        return {"registers": checked(await client.read_holding_registers(address, count=count), 3, count).registers}


@mcp.tool(annotations=WRITES)
async def write_register(address: Address, value: Value) -> dict[str, int]:
    """Write one holding register (function code 6)."""
    if os.environ.get("MODBUS_WRITES") != "true":
        raise ToolError("writes_disabled: MODBUS_WRITES is not true; nothing was sent")
    async with plc() as client:
        reply = checked(await client.write_register(address, value), 6)
    if (reply.address, reply.registers) != (address, [value]):
        raise ToolError(f"bad_reply: the PLC answered for register {reply.address}, value {reply.registers}")
    return {"address": address, "value": value}


if __name__ == "__main__":
    mcp.run()
