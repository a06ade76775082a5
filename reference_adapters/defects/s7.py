"""Defects of an S7 adapter."""

from __future__ import annotations

from functools import partial
from typing import Any

from ..core import AdapterServer, Call
from .any_protocol import guard_after_sending
from .areas.further import module_of
from .mutant import Data, Handler, Mutant, each, succeeding

__all__ = ["MUTANTS"]

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


def write_not_sent(server: AdapterServer) -> None:
    def instead(genuine: Handler) -> Handler:
        async def write(call: Call, arguments: Any) -> Data:
            return {
                "start": arguments.start_offset,
                "type": arguments.data_type,
                "value": arguments.value,
                "raw": _tools().encode(arguments.value, arguments.data_type).hex(),
            }

        return write

    each(_WRITE, change=instead)(server)


def read_modify_write(server: AdapterServer) -> None:
    read = server._tools["read_marker"]

    def whole_byte(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            held = (await read.handler(call, read.model(start_byte=arguments.start_byte, size=1)))["bytes"][0]
            mask = 1 << arguments.bit_index
            value = held | mask if arguments.value else held & ~mask
            changed = {"data_type": "BYTE", "bit_index": 0, "value": value}
            data: Data = await genuine(call, arguments.model_copy(update=changed))
            return {**data, "type": "BOOL", "value": arguments.value}

        return handler

    each(_MARKER, change=whole_byte)(server)


def always_running(server: AdapterServer) -> None:
    def constant(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            await genuine(call, arguments)
            return {"state": "RUN"}

        return handler

    each("read_cpu_state", change=constant)(server)


def _zero(call: Call, arguments: Any) -> Data:
    call.trace.clear()
    return {"start": arguments.start_offset, **_tools().decode(bytes(2), "INT")}


MUTANTS = (
    Mutant(
        id="MU-04k",
        protocol="s7",
        sentence="The bytes of every INT and DINT are swapped, in reads and writes alike.",
        bend=little_endian,
        items="K3 K4 FK1 FK2 FK4 SK1 SK2 SK3",
        requirements="CON-004 ENC-001 RD-001 WR-001",
    ),
    Mutant(
        id="MU-08k",
        protocol="s7",
        sentence="70000 is written as 4464, and told as a success.",
        bend=cut_off,
        items="FK2",
        requirements="ADR-003",
    ),
    Mutant(
        id="MU-14k",
        protocol="s7",
        sentence="A write succeeds, and nothing is sent.",
        bend=write_not_sent,
        items="K3 K4 FK2 SK2 SK4",
        requirements="WR-001",
    ),
    Mutant(
        id="MU-20k",
        protocol="s7",
        sentence="With writes disabled the write is sent, and then denied.",
        bend=guard_after_sending(_WRITE),
        items="K4",
        requirements="WR-004",
    ),
    Mutant(
        id="MU-28k",
        protocol="s7",
        sentence="A bit is written by reading its byte, changing the bit and writing the byte.",
        bend=read_modify_write,
        items="K5",
        requirements="WR-001 WR-011",
    ),
    Mutant(
        id="MU-36k",
        protocol="s7",
        sentence="The CPU is in RUN, whatever the controller says.",
        bend=always_running,
        items="K6",
        requirements="RD-001",
    ),
    Mutant(
        id="MU-46k",
        protocol="s7",
        sentence="What the controller refuses to read is 0.",
        bend=succeeding(_READ, code="access_denied", answer=_zero),
        items="FK4",
        requirements="RD-005",
    ),
)
