"""Honest S7 adapters."""

from __future__ import annotations

import asyncio
import dataclasses
import struct
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.defects.defect import Handler, wrap
from pytest_otmcp.reference_adapters.s7 import link as s7_link
from pytest_otmcp.reference_adapters.s7 import tools as s7_tools
from pytest_otmcp.reference_adapters.s7.codec import decode
from pytest_otmcp.reference_adapters.s7.link import Link
from pytest_otmcp.reference_adapters.s7.tools import Tools
from pytest_otmcp.reference_adapters.s7.wire import Variable
from snap7.datatypes import S7Area, S7WordLen

from pytest_otmcp.subject.model import Answering

from .choice import (
    POLLING_BESIDE_CALLS,
    again_after_silence,
    backed_off,
    background_call,
    choices,
    every_tool,
    in_background,
    one_call_at_a_time,
    one_connection_per_call,
    said_to_ask,
    twice_where_missing,
)

if TYPE_CHECKING:
    from pytest_otmcp.subject import Adapter

__all__ = ["CHOICES"]

CHOICES, choice = choices("s7")

WRITTEN = ("BOOL", "BYTE", "WORD", "DWORD", "INT", "DINT", "REAL")
READ = (*WRITTEN, "STRING")
_MOST = 40
"""Characters of a text, for an adapter that takes no long ones."""


def without_codes(adapter: Adapter) -> Adapter:
    """Return a description by which the adapter's answers are documents without error codes."""
    answering = Answering(form="structured")
    operations = {
        name: tuple(dataclasses.replace(one, answering=answering) for one in bound)
        for name, bound in adapter.operations.items()
    }
    return dataclasses.replace(adapter, answering=answering, operations=operations)


@choice(
    "tells a REAL by the fewest digits that make it: 0.1, not 0.10000000149011612",
    "these digits have the same bits when they are put into a REAL again",
)
def shortest_digits(server: AdapterServer) -> None:
    def shorter(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            if data["type"] != "REAL" or data["value"] is None:
                return data
            return {**data, "value": _shortest(data["value"])}

        return handler

    wrap(server, "read_db_typed", shorter)


def _shortest(value: float) -> float:
    candidates = (float(f"{value:.{digits}g}") for digits in range(1, 10))
    return next(one for one in candidates if _bits(one) == _bits(value))


def _bits(value: float) -> bytes | None:
    try:
        return struct.pack(">f", value)
    except OverflowError:
        return None


@choice(
    "writes texts of up to 40 characters, which the schema says, and refuses longer ones",
    "how long a text may be is its author's choice as far as the schema tells it",
)
def short_texts(server: AdapterServer) -> None:
    listing = server._tools["write_db"].listing
    properties = {
        **listing.input_schema["properties"],
        "value": {"anyOf": [{"type": ["boolean", "number"]}, {"type": "string", "maxLength": _MOST}]},
    }
    schema = {**listing.input_schema, "properties": properties}

    def refusing(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if isinstance(arguments.value, str) and len(arguments.value) > _MOST:
                message = f"a text may have {_MOST} characters"
                raise AdapterError("limit_exceeded", message, field="/value", outcome="not_sent")
            return await genuine(call, arguments)

        return handler

    wrap(server, "write_db", refusing, listing=listing.model_copy(update={"input_schema": schema}))


@choice(
    "has no tool that starts and stops the CPU unless control is enabled",
    "a tool that is not there cannot be used",
)
def control_tools_hidden(server: AdapterServer) -> None:
    if not server._tools["set_cpu_state"].handler.__self__._control_enabled:  # type: ignore[attr-defined]
        del server._tools["set_cpu_state"]


@choice(
    "reads types of up to 32 bits, and texts, which it does not write; refuses others in words without a code",
    "which types an adapter offers is its author's choice, and an answer need not have a code",
    described=without_codes,
)
def few_types(server: AdapterServer) -> None:
    def only(offered: tuple[str, ...]) -> Callable[[Handler], Handler]:
        def of_these_types(genuine: Handler) -> Handler:
            async def handler(call: Call, arguments: Any) -> Any:
                if arguments.data_type not in offered:
                    raise AdapterError("unsupported_operation", f"the types are {', '.join(offered)}")
                return await genuine(call, arguments)

            return handler

        return of_these_types

    wrap(server, "read_db_typed", only(READ))
    wrap(server, "write_db", only(WRITTEN))


def tools_of(server: AdapterServer) -> Tools:
    tools: Tools = server._tools["ping"].handler.__self__
    return tools


SIZES = {1: 256, 2: 64, 10: 64}
"""What an adapter has been told of the device: its data blocks, and how many bytes each has."""
BLOCK = 32

READS = ("read_db", "read_db_typed", "read_tag")


# -- connections ------------------------------------------------------------------------------------------------------


@choice("makes a connection for every call", "a connection is the adapter's own affair")
def connection_per_call(server: AdapterServer) -> None:
    one_connection_per_call(server, tools_of(server)._link.close)


@choice("writes over a second connection", "a connection is the adapter's own affair; a controller has several")
def connection_for_writing(server: AdapterServer) -> None:
    reading = tools_of(server)
    link = reading._link
    writing = Link(link._host, link._port, link._rack, link._slot, link._timeout_s)
    writer = Tools(writing, tags={}, control_enabled=reading._control_enabled)
    for name in ("write_db", "write_marker", "write_output", "set_cpu_state"):
        server._tools[name] = dataclasses.replace(server._tools[name], handler=getattr(writer, name))
    close = server._close

    async def close_both() -> None:
        await close()
        await writing.close()

    server._close = close_both


@choice(
    "tries to connect again 1.5 s after it has failed", "requirement REC-001: back within recovery_s, by default 5 s"
)
def backs_off_for_1500_ms(server: AdapterServer) -> None:
    link = tools_of(server)._link
    link._connected = backed_off(link._connected, 1.5)


@choice(
    "asks for PDUs of 240 bytes only, as an operator panel, and refuses by itself what does not fit into one",
    "the size of a PDU and the kind of a connection are agreed on; a controller 1200 has no larger PDU",
)
def small_pdus(server: AdapterServer) -> None:
    s7_link.PDU_SIZE = 240
    s7_link._CONNECTION_TYPE = 2 << 8


@choice(
    "begins to count its PDUs at 65,530", "the reference of a PDU is the client's, and comes back to 0 after 65,535"
)
def references_that_wrap(server: AdapterServer) -> None:
    link = tools_of(server)._link

    async def answer(connection: Any, request: bytes) -> bytes:
        await connection.send_data(request)
        while s7_link.reference(pdu := await connection.receive_data()) != s7_link.reference(request):
            pass
        return bytes(pdu)

    link.protocol.sequence = 65_530
    s7_link._answer = answer


@choice("ends its connection when it was not used for 50 ms", "a controller has few connections")
def hangs_up_when_idle(server: AdapterServer) -> None:
    link, at_work = tools_of(server)._link, 0
    timer: asyncio.TimerHandle | None = None

    def hang_up() -> None:
        if not at_work:
            link._drop(link._connection)

    def timed(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            nonlocal at_work, timer
            at_work += 1
            try:
                return await genuine(call, arguments)
            finally:
                at_work -= 1
                if timer is not None:
                    timer.cancel()
                timer = asyncio.get_running_loop().call_later(0.05, hang_up)

        return handler

    every_tool(server, timed)


choice("performs one call after the other", "the order of calls made at the same time is the adapter's own affair")(
    one_call_at_a_time
)


# -- reading ----------------------------------------------------------------------------------------------------------


@choice(
    "reads bytes eight by eight, by jobs of its own, and says that they are not of one moment",
    "requirement RD-007: a split read, with meta.atomic = false",
)
def bytes_in_parts(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def read(call: Call, area: str, db: int, start: int, size: int) -> Any:
        content = b""
        while len(content) < size:
            part = s7_tools._bytes(area, db, start + len(content), min(8, size - len(content)))
            content += b"".join(await tools._read(call, [part]))
        if size > 8:
            call.extra["atomic"] = False
        return {"start": start, "bytes": list(content)}

    tools._read_bytes = read


@choice(
    "reads bytes as variables of four bytes, by one job", "a job may have twenty variables, and is read at one moment"
)
def bytes_as_many_variables(server: AdapterServer) -> None:
    tools = tools_of(server)
    genuine = tools._read_bytes

    async def read(call: Call, area: str, db: int, start: int, size: int) -> Any:
        if size > 80:
            return await genuine(call, area, db, start, size)
        firsts = range(0, size, 4)
        parts = [s7_tools._bytes(area, db, start + first, min(4, size - first)) for first in firsts]
        return {"start": start, "bytes": list(b"".join(await tools._read(call, parts)))}

    tools._read_bytes = read


@choice(
    "reads the whole block of 32 bytes and answers the part",
    "the values are fresh; nobody forbids to read more at once",
)
def block_reads(server: AdapterServer) -> None:
    tools = tools_of(server)
    genuine = tools._read

    async def read(call: Call, variables: Sequence[Variable], *, question: bool = False) -> list[bytes]:
        (wanted, *others) = variables
        end = wanted.byte + wanted.size
        size = SIZES.get(wanted.db, 0)
        if others or wanted.area != S7Area.DB or wanted.bit is not None or end > size:
            return await genuine(call, variables, question=question)
        first = wanted.byte // BLOCK * BLOCK
        last = min(-(-end // BLOCK) * BLOCK, size)
        (content,) = await genuine(
            call, [dataclasses.replace(wanted, byte=first, size=last - first)], question=question
        )
        return [content[wanted.byte - first : end - first]]

    tools._read = read


@choice("reads the byte of a bit and answers the bit", "reading more than the bit changes nothing")
def bits_by_their_bytes(server: AdapterServer) -> None:
    tools = tools_of(server)

    def whole(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if arguments.data_type != "BOOL":
                return await genuine(call, arguments)
            byte = s7_tools._bytes("DB", arguments.db_number, arguments.start_offset, 1)
            (content,) = await tools._read(call, [byte])
            bit = bytes([content[0] >> arguments.bit_index & 1])
            return {"start": arguments.start_offset, **decode(bit, "BOOL")}

        return handler

    wrap(server, "read_db_typed", whole)


@choice(
    "addresses values with the transport sizes of their types (WORD, INT, DINT, REAL), not as bytes",
    "the variables of S7 have several transport sizes; a C library of the field uses them",
)
def typed_transport_sizes(server: AdapterServer) -> None:
    sizes = {"WORD": S7WordLen.WORD, "UINT": S7WordLen.WORD, "INT": S7WordLen.INT, "DWORD": S7WordLen.DWORD}
    sizes |= {"UDINT": S7WordLen.DWORD, "DINT": S7WordLen.DINT, "REAL": S7WordLen.REAL}
    value_of, read_job_of, items_of = s7_tools._value, s7_tools.read_job, s7_tools.items_of

    class Typed(Variable):
        """A variable of one element, whose type is told to the controller."""

        @property
        def transport(self) -> S7WordLen:
            kind: S7WordLen = self.__dict__["kind"]
            return kind

    def value(area: str, db: int, byte: int, kind: Any, bit: int) -> Variable:
        plain = value_of(area, db, byte, kind, bit)
        if kind not in sizes:
            return plain
        typed = Typed(area=plain.area, db=db, byte=byte, size=plain.size)
        typed.__dict__["kind"] = sizes[kind]
        return typed

    def read_job(protocol: Any, variables: Sequence[Variable]) -> bytes:
        job = bytearray(read_job_of(protocol, variables))
        for number, variable in enumerate(variables):
            if isinstance(variable, Typed):
                job[16 + 12 * number : 18 + 12 * number] = b"\0\1"
        return bytes(job)

    def items(request: bytes, reply: Any) -> list[tuple[int, bytes]]:
        in_bytes = bytearray(request)
        for number in range(request[11]):
            width = {4: 2, 5: 2, 6: 4, 7: 4, 8: 4}.get(request[15 + 12 * number], 1)
            count = int.from_bytes(request[16 + 12 * number : 18 + 12 * number], "big")
            in_bytes[16 + 12 * number : 18 + 12 * number] = (width * count).to_bytes(2, "big")
        return items_of(bytes(in_bytes), reply)

    s7_tools._value, s7_tools.read_job, s7_tools.items_of = value, read_job, items


@choice("asks again when the controller has no such thing", "a read may be repeated; meta.attempts says so")
def asks_twice_for_what_is_missing(server: AdapterServer) -> None:
    for name in READS:
        wrap(server, name, twice_where_missing)


@choice(
    "waits half as long and reads a second time when the controller was silent",
    "requirement TMO-002: a read may be repeated; meta.attempts says so",
    described=said_to_ask(2),
)
def reads_again_after_silence(server: AdapterServer) -> None:
    tools_of(server)._link._timeout_s /= 2
    again_after_silence(server, *READS, "ping", "read_cpu_state")


@choice("reads its flags fifty times a second, to keep the connection", "nobody forbids polling")
def keep_alive_reads(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def poll() -> None:
        await asyncio.sleep(0.02)
        await tools._read(background_call(server), [s7_tools._bytes("M", 0, 0, 4)])

    in_background(server, poll)


@choice(
    "polls the data block that the tasks read, fifty times a second",
    "nobody forbids polling",
    described=POLLING_BESIDE_CALLS,
)
def polls_the_same_block(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def poll() -> None:
        await asyncio.sleep(0.02)
        await tools._read(background_call(server), [s7_tools._bytes("DB", 10, 0, 64)])

    in_background(server, poll)


# -- status -----------------------------------------------------------------------------------------------------------


@choice("reads a flag as a ping", "any answer of the controller is one")
def ping_by_a_flag(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def ping(call: Call, arguments: Any) -> dict[str, bool]:
        await tools._read(call, [s7_tools._bytes("M", 0, 0, 1)])
        return {"reachable": True}

    wrap(server, "ping", lambda genuine: ping)


@choice("looks by a ping whether the CPU runs before it reads its state", "two questions change nothing")
def state_asked_twice(server: AdapterServer) -> None:
    tools = tools_of(server)

    def looked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            await tools._ask(call)
            return await genuine(call, arguments)

        return handler

    wrap(server, "read_cpu_state", looked)


# -- writing ----------------------------------------------------------------------------------------------------------


@choice(
    "reads every value back after it was written, and tells what the controller holds",
    "reading changes nothing; meta.attempts says so",
)
def reads_back_after_writing(server: AdapterServer) -> None:
    tools = tools_of(server)

    def checked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            if arguments.data_type == "STRING":
                return data
            wanted = s7_tools._value(
                "DB", arguments.db_number, arguments.start_offset, arguments.data_type, arguments.bit_index
            )
            trace = dict(call.trace)
            (held,) = await tools._read(call, [wanted], question=True)
            call.trace |= {**trace, "pdus": call.attempts, "references": call.trace["references"]}
            return {**data, "value": decode(held, arguments.data_type)["value"]}

        return handler

    wrap(server, "write_db", checked)


@choice("reads every value before it is written", "reading changes nothing; meta.attempts says so")
def reads_before_writing(server: AdapterServer) -> None:
    tools = tools_of(server)

    def looked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if arguments.data_type != "STRING":
                place = ("DB", arguments.db_number, arguments.start_offset, arguments.data_type, arguments.bit_index)
                await tools._read(call, [s7_tools._value(*place)], question=True)
            return await genuine(call, arguments)

        return handler

    wrap(server, "write_db", looked)


# -- refusing ---------------------------------------------------------------------------------------------------------


@choice(
    "has a list of data blocks and refuses what is not in it by itself",
    "a refusal that reaches no device is as good as the device's",
)
def list_of_blocks(server: AdapterServer) -> None:
    def known(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if arguments.db_number not in SIZES:
                message = "the configuration has no such data block"
                raise AdapterError("illegal_address", message, outcome="not_sent", field="/db_number")
            return await genuine(call, arguments)

        return handler

    for name in ("read_db", "read_db_typed", "write_db"):
        wrap(server, name, known)
