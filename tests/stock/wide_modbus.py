"""What else a Modbus adapter may offer, with stock parts alone: docs/first-adapter/modbus.py with coils, blocks, numbers, units, identification."""

from __future__ import annotations

import base64
import math
import os
import sys
from pathlib import Path
from typing import Any, Literal

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "first-adapter"))

import modbus
from mcp.server.mcpserver.exceptions import ToolError
from modbus import Address, mcp, plc
from pymodbus.client import ModbusTcpClient
from strict_mcp import READS, WRITES, strict

Unit = strict(int, "unit identifier", ge=1, le=247)
Bits = strict(int, "number of coils", ge=1, le=2000)
Count = strict(int, "number of registers", ge=1, le=125)
Word = strict(int, "mask", ge=0, le=65535)
Words = strict(list[modbus.Value], "values of the registers", min_length=1, max_length=123)
SPECIAL = {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}


def writable() -> None:
    if os.environ.get("MODBUS_WRITES") != "true":
        raise ToolError("writes_disabled: MODBUS_WRITES is not true; nothing was sent")


@mcp.tool(annotations=READS)
def read_unit(address: Address, count: Count = 1, unit: Unit = 1) -> dict[str, list[int]]:
    """Read holding registers of a unit behind a gateway."""
    with plc() as client:
        reply = client.read_holding_registers(address, count=count, device_id=unit)
        return {"registers": modbus.checked(reply, 3, count).registers}


@mcp.tool(annotations=READS)
def read_coils(address: Address, count: Bits) -> dict[str, list[bool]]:
    """Read coils (function code 1)."""
    with plc() as client:
        reply = client.read_coils(address, count=count)
    if reply.isError():
        raise ToolError(f"modbus exception {reply.exception_code}: the PLC refused")
    # pymodbus fills the last byte.
    if reply.function_code != 1 or len(reply.bits) != -(-count // 8) * 8:
        raise ToolError("bad_reply: another number of coils")
    return {"coils": reply.bits[:count]}


@mcp.tool(annotations=WRITES)
def write_registers(address: Address, values: Words) -> dict[str, Any]:
    """Write several holding registers (function code 16)."""
    writable()
    with plc() as client:
        reply = client.write_registers(address, values)
    if reply.isError():
        raise ToolError(f"modbus exception {reply.exception_code}: the PLC refused")
    if (reply.function_code, reply.address, reply.count) != (16, address, len(values)):
        raise ToolError("bad_reply: the PLC answered for something else")
    return {"values": values}


@mcp.tool(annotations=WRITES)
def mask_write(address: Address, and_mask: Word, or_mask: Word) -> dict[str, int]:
    """Change some bits of a holding register (function code 22)."""
    writable()
    with plc() as client:
        reply = client.mask_write_register(address=address, and_mask=and_mask, or_mask=or_mask)
    if reply.isError():
        raise ToolError(f"modbus exception {reply.exception_code}: the PLC refused")
    if (reply.function_code, reply.address, reply.and_mask, reply.or_mask) != (22, address, and_mask, or_mask):
        raise ToolError("bad_reply: the PLC answered for something else")
    return {"and_mask": and_mask, "or_mask": or_mask}


@mcp.tool(annotations=READS)
def read_typed(
    address: Address,
    kind: Literal["int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"],
    order: Literal["ABCD", "CDAB"] = "ABCD",
) -> dict[str, Any]:
    """Read a number of several holding registers."""
    type_ = ModbusTcpClient.DATATYPE[kind.upper()]
    count = type_.value[1]
    with plc() as client:
        registers = modbus.checked(client.read_holding_registers(address, count=count), 3, count).registers
    value = ModbusTcpClient.convert_from_registers(registers, type_, "big" if order == "ABCD" else "little")
    assert isinstance(value, (int, float))
    if isinstance(value, float) and not math.isfinite(value):
        return {"value": None, "special": SPECIAL[str(value)]}
    return {"value": str(value) if isinstance(value, int) and abs(value) >= 2**53 else value, "special": None}


@mcp.tool(annotations=READS)
def read_device_information() -> dict[str, dict[str, str]]:
    """Read the identification (function code 43/14)."""
    objects: dict[str, str] = {}
    with plc() as client:
        following = 0
        while True:
            reply = client.read_device_information(read_code=3, object_id=following)
            if reply.isError():
                raise ToolError(f"modbus exception {reply.exception_code}: the PLC refused")
            objects |= {str(number): text(held) for number, held in reply.information.items()}
            if not reply.more_follows or reply.next_object_id <= following:
                return {"objects": objects}
            following = reply.next_object_id


def text(held: Any) -> str:
    """Return an object as text, or as base64 with a mark."""
    content: bytes = held if isinstance(held, bytes) else b"".join(held)
    try:
        return content.decode()
    except UnicodeDecodeError:
        return f"base64:{base64.b64encode(content).decode()}"


if __name__ == "__main__":
    mcp.run()
