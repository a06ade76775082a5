"""Defects of an EtherNet/IP adapter."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import partial
from typing import Any

from ..core import AdapterServer, Call
from .any_protocol import guard_after_sending
from .areas.further import module_of
from .mutant import Data, Handler, Mutant, each, succeeding, told

__all__ = ["MUTANTS"]

_READ, _WRITE, _WRITE_MANY = "read_tag", "write_tag", "write_multiple_tags"
_CALLS_PER_CONNECTION = 10

_module = partial(module_of, "ethernetip")


def _now() -> str:
    return datetime.now(UTC).replace(tzinfo=None).isoformat(timespec="milliseconds")


def machines_time(server: AdapterServer) -> None:
    def setting(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            await genuine(call, arguments.model_copy(update={"time": _now()}))
            return {"time": arguments.time}

        return handler

    each("set_plc_time", change=setting)(server)


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


def write_not_sent(server: AdapterServer) -> None:
    def instead(genuine: Handler) -> Handler:
        async def write(call: Call, arguments: Any) -> Data:
            content = _module("codec").encode(arguments.value, arguments.data_type)
            return {
                "tag_name": arguments.tag_name,
                "type": arguments.data_type,
                "value": arguments.value,
                "raw": content.hex(),
                "status": 0,
            }

        return write

    each(_WRITE, change=instead)(server)


def read_modify_write(server: AdapterServer) -> None:
    read = server._tools[_READ]

    def whole_word(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            word, _, bit = arguments.tag_name.rpartition(".")
            if not bit.isdecimal():
                data: Data = await genuine(call, arguments)
                return data
            held = (await read.handler(call, read.model(tag_name=word)))["value"]
            mask = 1 << int(bit)
            changed = {
                "tag_name": word,
                "value": held | mask if arguments.value else held & ~mask,
                "data_type": None,
            }
            data = await genuine(call, arguments.model_copy(update=changed))
            return {**data, "tag_name": arguments.tag_name, "type": "BOOL", "value": arguments.value}

        return handler

    each(_WRITE, change=whole_word)(server)


def _zero(call: Call, arguments: Any) -> Data:
    call.trace.clear()
    return {"tag_name": arguments.tag_name, **_module("codec").decode(bytes(4), "DINT")}


def _all_written(call: Call, arguments: Any) -> Data:
    call.trace.clear()
    written = [{"tag_name": one.tag_name, "value": one.value} for one in arguments.payloads]
    return {"tags": [{**one, "type": "DINT", "raw": "", "status": 0} for one in written]}


def _link(server: AdapterServer) -> Any:
    handler: Any = server._tools["ping"].handler
    return handler.__self__._link


def connections_forgotten(server: AdapterServer) -> None:
    link = _link(server)
    kept: list[Any] = []
    calls = 0

    def forgetful(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            nonlocal calls
            calls += 1
            if calls % _CALLS_PER_CONNECTION == 0:
                kept.append(link._connection)
                link._connection = None
            data: Data = await genuine(call, arguments)
            return data

        return handler

    each(_READ, change=forgetful)(server)


def leaves_without_a_word(server: AdapterServer) -> None:
    link = _link(server)

    async def close() -> None:
        link._drop(link._connection)

    server._close = close


MUTANTS = (
    Mutant(
        id="MU-02ei",
        protocol="ethernetip",
        sentence="The controller's clock is set to the time of the adapter's machine, whichever time was asked for.",
        bend=machines_time,
        items="E7",
        requirements="WR-001",
    ),
    Mutant(
        id="MU-04ei",
        protocol="ethernetip",
        sentence="The bytes of every DINT are swapped, in reads and writes alike.",
        bend=big_endian,
        items="E3 E4 E6 FE1 FE2 FE4 SE2",
        requirements="CON-004 ENC-001 RD-001 WR-001",
    ),
    Mutant(
        id="MU-08ei",
        protocol="ethernetip",
        sentence="2 to the 40 is written as 0 to a DINT, and told as a success.",
        bend=cut_off,
        items="FE2",
        requirements="ADR-003",
    ),
    Mutant(
        id="MU-14ei",
        protocol="ethernetip",
        sentence="A write of a tag succeeds, and nothing is sent.",
        bend=write_not_sent,
        items="E3 E4 E5 FE2 FE5 SE2 SE4",
        requirements="WR-001",
    ),
    Mutant(
        id="MU-20ei",
        protocol="ethernetip",
        sentence="With writes disabled the tag is written, and the write then denied.",
        bend=guard_after_sending(_WRITE),
        items="E4",
        requirements="WR-004",
    ),
    Mutant(
        id="MU-28ei",
        protocol="ethernetip",
        sentence="A bit is written by reading its word, changing the bit and writing the word.",
        bend=read_modify_write,
        items="E5",
        requirements="WR-001 WR-011",
    ),
    Mutant(
        id="MU-36ei",
        protocol="ethernetip",
        sentence="The controller's clock has the time of the adapter's machine, whatever the controller says.",
        bend=told("get_plc_time", change=lambda data: {"time": _now()}),
        items="E7",
        requirements="RD-001",
    ),
    Mutant(
        id="MU-46ei",
        protocol="ethernetip",
        sentence="A tag that the controller does not have is 0.",
        bend=succeeding(_READ, code="illegal_address", answer=_zero),
        items="FE1",
        requirements="ERR-002",
    ),
    Mutant(
        id="MU-61ei",
        protocol="ethernetip",
        sentence="A packet of services is a success when it is answered, whatever the answers to the services are.",
        bend=succeeding(_WRITE_MANY, code="partial_failure", answer=_all_written),
        items="FE4",
        requirements="ERR-008",
    ),
    Mutant(
        id="MU-90ei",
        protocol="ethernetip",
        sentence="Every tenth read opens a new CIP connection, and forgets the one before.",
        bend=connections_forgotten,
        items="E6",
        requirements="RES-001",
    ),
    Mutant(
        id="MU-90eib",
        protocol="ethernetip",
        sentence="The CIP connection is not closed when the adapter ends.",
        bend=leaves_without_a_word,
        items="E6",
        requirements="RES-001",
    ),
)
