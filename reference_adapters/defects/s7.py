"""Defects of an S7 adapter."""

from __future__ import annotations

from functools import partial
from typing import Any

from ..core import AdapterServer, Call
from .any_protocol import guard_after_sending
from .areas.further import module_of
from .defect import Data, Handler, around, defect, succeeding

__all__ = ["DEFECTS"]

_READ, _WRITE, _MARKER = "read_db_typed", "write_db", "write_marker"

_tools = partial(module_of, "s7", "tools")


def little_endian(server: AdapterServer) -> None:
    """Swap the bytes of every INT and DINT, in reads and writes alike."""
    tools = _tools()
    encode, decode = tools.encode, tools.decode

    def swapped(content: bytes, kind: str) -> bytes:
        return content[::-1] if kind in ("INT", "DINT") else content

    tools.encode = lambda value, kind, *rest: swapped(encode(value, kind, *rest), kind)
    tools.decode = lambda content, kind: decode(swapped(content, kind), kind)


def cut_off(server: AdapterServer) -> None:
    """Write the lower half of a number that is too large."""
    tools = _tools()
    encode = tools.encode

    def fitting(value: Any, kind: Any, *rest: Any) -> bytes:
        content: bytes = encode((value + 0x8000) % 0x10000 - 0x8000 if kind == "INT" else value, kind, *rest)
        return content

    tools.encode = fitting


@around(_WRITE)
async def write_not_sent(genuine: Handler, call: Call, arguments: Any) -> Data:
    return {
        "start": arguments.start_offset,
        "type": arguments.data_type,
        "value": arguments.value,
        "raw": _tools().encode(arguments.value, arguments.data_type).hex(),
    }


def read_modify_write(server: AdapterServer) -> None:
    read = server._tools["read_marker"]

    @around(_MARKER)
    async def whole_byte(genuine: Handler, call: Call, arguments: Any) -> Data:
        held = (await read.handler(call, read.model(start_byte=arguments.start_byte, size=1)))["bytes"][0]
        mask = 1 << arguments.bit_index
        value = held | mask if arguments.value else held & ~mask
        changed = {"data_type": "BYTE", "bit_index": 0, "value": value}
        data = await genuine(call, arguments.model_copy(update=changed))
        return {**data, "type": "BOOL", "value": arguments.value}

    whole_byte(server)


@around("read_cpu_state")
async def always_running(genuine: Handler, call: Call, arguments: Any) -> Data:
    await genuine(call, arguments)
    return {"state": "RUN"}


def _zero(call: Call, arguments: Any) -> Data:
    call.trace.clear()
    return {"start": arguments.start_offset, **_tools().decode(bytes(2), "INT")}


DEFECTS = (
    defect(
        "MU-04k",
        "s7",
        "The bytes of every INT and DINT are swapped, in reads and writes alike.",
        little_endian,
        "K3 K4 FK1 FK2 FK4 SK1 SK2 SK3",
        "CON-004 ENC-001 RD-001 WR-001",
    ),
    defect("MU-08k", "s7", "70000 is written as 4464, and told as a success.", cut_off, "FK2", "ADR-003"),
    defect("MU-14k", "s7", "A write succeeds, and nothing is sent.", write_not_sent, "K3 K4 FK2 SK2 SK4", "WR-001"),
    defect(
        "MU-20k",
        "s7",
        "With writes disabled the write is sent, and then denied.",
        guard_after_sending(_WRITE),
        "K4",
        "WR-004",
    ),
    defect(
        "MU-28k",
        "s7",
        "A bit is written by reading its byte, changing the bit and writing the byte.",
        read_modify_write,
        "K5",
        "WR-001 WR-011",
    ),
    defect("MU-36k", "s7", "The CPU is in RUN, whatever the controller says.", always_running, "K6", "RD-001"),
    defect(
        "MU-46k",
        "s7",
        "What the controller refuses to read is 0.",
        succeeding(_READ, code="access_denied", answer=_zero),
        "FK4",
        "RD-005",
    ),
)
