"""Defects of an EtherNet/IP adapter."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import partial
from typing import Any

from ..core import AdapterServer, Call
from .any_protocol import guard_after_sending
from .areas.further import module_of
from .defect import Data, Handler, around, defect, succeeding, told, tools_of

__all__ = ["DEFECTS"]

_READ, _WRITE, _WRITE_MANY = "read_tag", "write_tag", "write_multiple_tags"
_CALLS_PER_CONNECTION = 10

_module = partial(module_of, "ethernetip")


def _now() -> str:
    return datetime.now(UTC).replace(tzinfo=None).isoformat(timespec="milliseconds")


@around("set_plc_time")
async def machines_time(genuine: Handler, call: Call, arguments: Any) -> Data:
    await genuine(call, arguments.model_copy(update={"time": _now()}))
    return {"time": arguments.time}


def big_endian(server: AdapterServer) -> None:
    """Swap the bytes of every DINT, in reads and writes alike."""
    tools = _module("tools")
    encode, decode = tools.encode, tools.decode

    def swapped(content: bytes, kind: str) -> bytes:
        return content[::-1] if kind == "DINT" else content

    tools.encode = lambda value, kind, *rest: swapped(encode(value, kind, *rest), kind)
    tools.decode = lambda content, kind: decode(swapped(content, kind), kind)


def cut_off(server: AdapterServer) -> None:
    """Write the lower 32 bits of a number that is too large."""
    tools = _module("tools")
    encode = tools.encode

    def fitting(value: Any, kind: Any, *rest: Any) -> bytes:
        cut = (value + 2**31) % 2**32 - 2**31 if kind == "DINT" and type(value) is int else value
        content: bytes = encode(cut, kind, *rest)
        return content

    tools.encode = fitting


@around(_WRITE)
async def write_not_sent(genuine: Handler, call: Call, arguments: Any) -> Data:
    content = _module("codec").encode(arguments.value, arguments.data_type)
    return {
        "tag_name": arguments.tag_name,
        "type": arguments.data_type,
        "value": arguments.value,
        "raw": content.hex(),
        "status": 0,
    }


def read_modify_write(server: AdapterServer) -> None:
    read = server._tools[_READ]

    @around(_WRITE)
    async def whole_word(genuine: Handler, call: Call, arguments: Any) -> Data:
        word, _, bit = arguments.tag_name.rpartition(".")
        if not bit.isdecimal():
            return await genuine(call, arguments)
        held = (await read.handler(call, read.model(tag_name=word)))["value"]
        mask = 1 << int(bit)
        changed = {
            "tag_name": word,
            "value": held | mask if arguments.value else held & ~mask,
            "data_type": None,
        }
        data = await genuine(call, arguments.model_copy(update=changed))
        return {**data, "tag_name": arguments.tag_name, "type": "BOOL", "value": arguments.value}

    whole_word(server)


def _zero(call: Call, arguments: Any) -> Data:
    call.trace.clear()
    return {"tag_name": arguments.tag_name, **_module("codec").decode(bytes(4), "DINT")}


def _all_written(call: Call, arguments: Any) -> Data:
    call.trace.clear()
    written = [{"tag_name": one.tag_name, "value": one.value} for one in arguments.payloads]
    return {"tags": [{**one, "type": "DINT", "raw": "", "status": 0} for one in written]}


def _link(server: AdapterServer) -> Any:
    return tools_of(server, "ping")._link


def connections_forgotten(server: AdapterServer) -> None:
    link = _link(server)
    kept: list[Any] = []
    calls = 0

    @around(_READ)
    async def forgetful(genuine: Handler, call: Call, arguments: Any) -> Data:
        nonlocal calls
        calls += 1
        if calls % _CALLS_PER_CONNECTION == 0:
            kept.append(link._connection)
            link._connection = None
        data = await genuine(call, arguments)
        return data

    forgetful(server)


def leaves_without_a_word(server: AdapterServer) -> None:
    link = _link(server)

    async def close() -> None:
        link._drop(link._connection)

    server._close = close


DEFECTS = (
    defect(
        "MU-02ei",
        "ethernetip",
        "The controller's clock is set to the time of the adapter's machine, whichever time was asked for.",
        machines_time,
        "E7",
        "WR-001",
    ),
    defect(
        "MU-04ei",
        "ethernetip",
        "The bytes of every DINT are swapped, in reads and writes alike.",
        big_endian,
        "E3 E4 E6 FE1 FE2 FE4 SE2",
        "CON-004 ENC-001 RD-001 WR-001",
    ),
    defect(
        "MU-08ei",
        "ethernetip",
        "2 to the 40 is written as 0 to a DINT, and told as a success.",
        cut_off,
        "FE2",
        "ADR-003",
    ),
    defect(
        "MU-14ei",
        "ethernetip",
        "A write of a tag succeeds, and nothing is sent.",
        write_not_sent,
        "E3 E4 E5 FE2 FE5 SE2 SE4",
        "WR-001",
    ),
    defect(
        "MU-20ei",
        "ethernetip",
        "With writes disabled the tag is written, and the write then denied.",
        guard_after_sending(_WRITE),
        "E4",
        "WR-004",
    ),
    defect(
        "MU-28ei",
        "ethernetip",
        "A bit is written by reading its word, changing the bit and writing the word.",
        read_modify_write,
        "E5",
        "WR-001 WR-011",
    ),
    defect(
        "MU-36ei",
        "ethernetip",
        "The controller's clock has the time of the adapter's machine, whatever the controller says.",
        told("get_plc_time", change=lambda data: {"time": _now()}),
        "E7",
        "RD-001",
    ),
    defect(
        "MU-46ei",
        "ethernetip",
        "A tag that the controller does not have is 0.",
        succeeding(_READ, code="illegal_address", answer=_zero),
        "FE1",
        "ERR-002",
    ),
    defect(
        "MU-61ei",
        "ethernetip",
        "A packet of services is a success when it is answered, whatever the answers to the services are.",
        succeeding(_WRITE_MANY, code="partial_failure", answer=_all_written),
        "FE4",
        "ERR-008",
    ),
    defect(
        "MU-90ei",
        "ethernetip",
        "Every tenth read opens a new CIP connection, and forgets the one before.",
        connections_forgotten,
        "E6",
        "RES-001",
    ),
    defect(
        "MU-90eib",
        "ethernetip",
        "The CIP connection is not closed when the adapter ends.",
        leaves_without_a_word,
        "E6",
        "RES-001",
    ),
)
