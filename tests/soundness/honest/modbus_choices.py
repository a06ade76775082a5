"""Honest Modbus adapters."""

from __future__ import annotations

import asyncio
import dataclasses
import ssl
from collections.abc import Awaitable, Callable
from typing import Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.defects.defect import Handler, failing, wrap
from pytest_otmcp.reference_adapters.modbus.link import Link
from pytest_otmcp.reference_adapters.modbus.shapes import Registers, Unit
from pytest_otmcp.reference_adapters.modbus.tools import Tools

from .choice import (
    Change,
    again_after_silence,
    backed_off,
    background_call,
    choices,
    deaf_to_cancellation,
    in_background,
    narrowed,
    one_call_at_a_time,
    said_to_ask,
    twice_where_missing,
)

__all__ = ["CHOICES"]

CHOICES, choice = choices("modbus")

Read = Callable[..., Awaitable[list[int]]]

REGISTERS = 100
"""What the adapter has been told of the device: so many registers in each table."""

BLOCK = 20


def tools_of(server: AdapterServer) -> Tools:
    tools: Tools = server._tools["ping"].handler.__self__
    return tools


def other_reads(server: AdapterServer, read: Callable[[Read], Read]) -> None:
    tools = tools_of(server)
    tools._inputs = read(tools._inputs)
    tools._holding = read(tools._holding)


def in_parts(size: int) -> Callable[[Read], Read]:
    def parted(genuine: Read) -> Read:
        async def read(call: Call, arguments: Any, address: int, count: int) -> list[int]:
            # A number of several registers comes from one request (requirement RD-007).
            if not isinstance(arguments, Registers):
                return await genuine(call, arguments, address, count)
            values: list[int] = []
            while len(values) < count:
                values += await genuine(call, arguments, address + len(values), min(size, count - len(values)))
            if count > size:
                call.extra["atomic"] = False
            return values

        return read

    return parted


# -- reading ----------------------------------------------------------------------------------------------------------


@choice("reads four registers by two requests of two", "requirement RD-007: a split read, with meta.atomic = false")
def split_reads(server: AdapterServer) -> None:
    other_reads(server, in_parts(2))


@choice("reads register by register", "requirement RD-007: a split read, with meta.atomic = false")
def single_reads(server: AdapterServer) -> None:
    other_reads(server, in_parts(1))


@choice(
    "reads the whole block of twenty registers and answers the part",
    "the values are fresh; nobody forbids a larger quantity",
)
def block_reads(server: AdapterServer) -> None:
    def whole(genuine: Read) -> Read:
        async def read(call: Call, arguments: Any, address: int, count: int) -> list[int]:
            if address + count > REGISTERS:
                return await genuine(call, arguments, address, count)
            first = address // BLOCK * BLOCK
            last = -(-(address + count) // BLOCK) * BLOCK
            values = await genuine(call, arguments, first, last - first)
            return values[address - first :][:count]

        return read

    other_reads(server, whole)


@choice(
    "reads everything twice and answers the second result",
    "a read changes nothing and may be repeated; meta.attempts says so",
)
def repeated_reads(server: AdapterServer) -> None:
    def twice(genuine: Read) -> Read:
        async def read(call: Call, arguments: Any, address: int, count: int) -> list[int]:
            await genuine(call, arguments, address, count)
            return await genuine(call, arguments, address, count)

        return read

    other_reads(server, twice)


@choice("asks again when the device refuses a read", "a read may be repeated; meta.attempts says so")
def asks_twice_for_a_missing_register(server: AdapterServer) -> None:
    for name in ("read_register", "read_multiple_holding_registers", "read_input_registers"):
        wrap(server, name, twice_where_missing)


@choice(
    "reads one at a time, and gives a read up that has waited a second for another one",
    "rate_limited: nothing of the call was sent, and the caller may come again",
)
def gives_up_what_waits(server: AdapterServer) -> None:
    turn = asyncio.Lock()

    def in_turn(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            try:
                await asyncio.wait_for(turn.acquire(), 1.0)
            except TimeoutError:
                raise AdapterError("rate_limited", "another read takes long", outcome="not_sent") from None
            try:
                return await genuine(call, arguments)
            finally:
                turn.release()

        return handler

    for name in ("read_register", "read_multiple_holding_registers", "read_input_registers"):
        wrap(server, name, in_turn)


@choice(
    "gives every integer of 64 bits as its digits, also a small one", "RFC 7493, section 2.2: such numbers as texts"
)
def long_integers_as_texts(server: AdapterServer) -> None:
    def spelt(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            return {**data, "value": str(data["value"])} if arguments.data_type in ("int64", "uint64") else data

        return handler

    for name in ("read_holding_typed", "read_input_typed"):
        wrap(server, name, spelt)


@choice("has tags with a scale and none with an offset", "an offset can be calculated by whoever reads the value")
def tags_without_offset(server: AdapterServer) -> None:
    def known(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if arguments.tag == "otmcp_shifted":
                raise AdapterError("illegal_address", "there is no such tag", outcome="not_sent", field="/tag")
            return await genuine(call, arguments)

        return handler

    for name in ("read_tag", "write_tag"):
        wrap(server, name, known)


def polling(table: str, address: int, count: int) -> Change:
    def apply(server: AdapterServer) -> None:
        read: Read = getattr(tools_of(server), table)

        async def poll() -> None:
            await asyncio.sleep(0.02)
            await read(background_call(server), Unit(), address, count)

        in_background(server, poll)

    return apply


@choice(
    "polls the registers that the tasks read, fifty times a second",
    "meta.attempts counts what is sent for the call; nobody forbids polling",
)
def polls_the_same_registers(server: AdapterServer) -> None:
    polling("_inputs", 0, 4)(server)


@choice("polls other registers, fifty times a second", "nobody forbids polling")
def polls_other_registers(server: AdapterServer) -> None:
    polling("_holding", 40, 8)(server)


# -- refusing ---------------------------------------------------------------------------------------------------------


def with_register_map(code: str, outcome: str) -> Change:
    def known(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if arguments.address >= REGISTERS:
                message = "the register map has no such address"
                raise AdapterError(code, message, outcome=outcome, field="/address")
            return await genuine(call, arguments)

        return handler

    def apply(server: AdapterServer) -> None:
        for name in ("read_register", "read_multiple_holding_registers", "read_input_registers", "write_register"):
            wrap(server, name, known)

    return apply


@choice(
    "has a register map and refuses what is not in it by itself",
    "a refusal that reaches no device is as good as the device's",
)
def register_map(server: AdapterServer) -> None:
    with_register_map("illegal_address", "not_sent")(server)


@choice(
    "has a register map and calls what is not in it an invalid input",
    "a refusal that reaches no device is as good as the device's",
)
def register_map_as_validation(server: AdapterServer) -> None:
    with_register_map("invalid_input", "not_sent")(server)


# -- writing ----------------------------------------------------------------------------------------------------------


@choice("writes one register by function 16", "MODBUS Application Protocol, section 6.12: a quantity of one is legal")
def writes_one_register_as_a_block(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def write(call: Call, arguments: Any) -> dict[str, int]:
        await tools._write_block(call, arguments, arguments.address, [arguments.value])
        return {"address": arguments.address, "value": arguments.value}

    wrap(server, "write_register", lambda genuine: write)


@choice("reads every register back after it was written", "reading changes nothing; meta.attempts says so")
def reads_back_after_writing(server: AdapterServer) -> None:
    tools = tools_of(server)

    def checked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            (held,) = await tools._holding(call, arguments, arguments.address, 1)
            return {**data, "value": held}

        return handler

    wrap(server, "write_register", checked)


@choice("reads every register before it is written", "reading changes nothing; meta.attempts says so")
def reads_before_writing(server: AdapterServer) -> None:
    tools = tools_of(server)

    def looked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            # A question of a writing tool: what breaks here has not been written.
            question = background_call(server)
            try:
                await tools._holding(question, arguments, arguments.address, 1)
            except AdapterError as error:
                # What cannot be read may still be refused for another reason.
                if not error.code.startswith("gateway_"):
                    raise
            call.attempts += question.attempts
            return await genuine(call, arguments)

        return handler

    wrap(server, "write_register", looked)


# -- connections ------------------------------------------------------------------------------------------------------


@choice("makes a connection for every request", "a connection is the adapter's own affair")
def connection_per_request(server: AdapterServer) -> None:
    link = tools_of(server)._link
    genuine, alone = link.exchange, asyncio.Lock()

    async def exchange(*arguments: Any) -> Any:
        async with alone:
            try:
                return await genuine(*arguments)
            finally:
                link._drop(link._connection)

    link.exchange = exchange


@choice("writes over a second connection", "a connection is the adapter's own affair")
def connection_for_writing(server: AdapterServer) -> None:
    reading = tools_of(server)._link
    writing = Link(reading._host, reading._port, reading._timeout_s)
    writer = Tools(writing, default_unit=1, tags={})
    for name in ("write_register", "write_registers"):
        server._tools[name] = dataclasses.replace(server._tools[name], handler=getattr(writer, name))
    close = server._close

    async def close_both() -> None:
        await close()
        await writing.close()

    server._close = close_both


def pause_after_failure(seconds: float) -> Change:
    def apply(server: AdapterServer) -> None:
        link = tools_of(server)._link
        link._connected = backed_off(link._connected, seconds)

    return apply


@choice(
    "tries to connect again 1.5 s after it has failed", "requirement REC-001: back within recovery_s, by default 5 s"
)
def backs_off_for_1500_ms(server: AdapterServer) -> None:
    pause_after_failure(1.5)(server)


@choice("tries to connect again 4 s after it has failed", "requirement REC-001: back within recovery_s, by default 5 s")
def backs_off_for_4_s(server: AdapterServer) -> None:
    pause_after_failure(4.0)(server)


@choice(
    "declares that it is back within 3 s, and is",
    "requirement REC-001",
    described=lambda adapter: dataclasses.replace(adapter, recovery_s=3.0),
)
def backs_off_as_declared(server: AdapterServer) -> None:
    pause_after_failure(2.0)(server)


def noticed_late(genuine: Handler) -> Handler:
    """Return a handler that waits in vain in the first call of an outage, and finds the connection broken in the second."""
    failures = 0

    async def handler(call: Call, arguments: Any) -> Any:
        nonlocal failures
        try:
            answer = await genuine(call, arguments)
        except AdapterError as error:
            failures += error.code in ("connect_failed", "connection_lost", "timeout")
            if failures == 1:
                raise AdapterError("timeout", "the device did not reply in time") from None
            if failures == 2:
                raise AdapterError("connection_lost", "the connection is broken") from None
            raise error
        failures = 0
        return answer

    return handler


@choice(
    "times out before it notices that the connection is lost", "requirement ERR-005: each code says what the call met"
)
def notices_a_loss_late(server: AdapterServer) -> None:
    wrap(server, "read_input_registers", noticed_late)


# -- bounds of its own -------------------------------------------------------------------------------------------------

OWN_BOUND = "its schema says so: a smaller maximum is the author's choice"


@choice("writes at most 32 registers or coils at once", OWN_BOUND)
def blocks_of_32(server: AdapterServer) -> None:
    narrowed(server, "write_registers", "values", "maxItems", 32)
    narrowed(server, "write_coils_bulk", "values", "maxItems", 32)


@choice("writes at most 2 registers and 4 coils at once", OWN_BOUND)
def blocks_of_2(server: AdapterServer) -> None:
    narrowed(server, "write_registers", "values", "maxItems", 2)
    narrowed(server, "write_coils_bulk", "values", "maxItems", 4)


@choice("reads at most 8 registers or bits at once", OWN_BOUND)
def reads_of_8(server: AdapterServer) -> None:
    for tool in ("read_input_registers", "read_multiple_holding_registers", "read_coils", "read_discrete_inputs"):
        narrowed(server, tool, "count", "maximum", 8)


@choice("writes values of at most 1000", OWN_BOUND)
def values_up_to_1000(server: AdapterServer) -> None:
    narrowed(server, "write_register", "value", "maximum", 1000)


# -- status -----------------------------------------------------------------------------------------------------------


@choice("asks the device for its identification as a ping", "any answer of the device is one; function 2B/0E")
def ping_by_identification(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def ping(call: Call, arguments: Any) -> dict[str, bool]:
        await tools._identification(call, arguments, 0)
        return {"reachable": True}

    wrap(server, "ping", lambda genuine: ping)


@choice("reads an input register as a ping", "any answer of the device is one")
def ping_by_an_input_register(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def ping(call: Call, arguments: Any) -> dict[str, bool]:
        await tools._inputs(call, arguments, 8, 1)
        return {"reachable": True}

    wrap(server, "ping", lambda genuine: ping)


@choice(
    "waits a third as long and asks a silent device three times, as the subject file says",
    "requirement TMO-002: a read may be repeated; meta.attempts says so",
    described=said_to_ask(3),
)
def asks_three_times(server: AdapterServer) -> None:
    tools_of(server)._link._timeout_s /= 3
    reads = ("read_input_registers", "read_multiple_holding_registers", "read_coils", "read_discrete_inputs", "ping")
    again_after_silence(server, *reads, times=2)


choice("performs one call after the other", "the order of calls made at the same time is the adapter's own affair")(
    one_call_at_a_time
)


choice(
    "performs one call after the other, and does not hear of cancellations",
    "MCP, Cancellation: a receiver may ignore them; a write that waits for its turn should not be carried out any more",
    checked_warnings=(("TMO-003", "cancelled_write"),),
)(deaf_to_cancellation)


@choice("speaks TLS 1.2 alone", "requirement TLS-002: TLS is at least 1.2")
def tls_1_2_alone(server: AdapterServer) -> None:
    if (context := tools_of(server)._link._tls) is not None:
        context.maximum_version = ssl.TLSVersion.TLSv1_2


@choice(
    "compares the host with the certificate when the handshake is complete, and then sends nothing",
    "requirement TLS-002: the device gets no data; some libraries leave this comparison to their callers",
)
def compares_hosts_after_the_handshake(server: AdapterServer) -> None:
    link = tools_of(server)._link
    if link._tls is None:
        return
    link._tls.check_hostname = False
    genuine = link._open

    async def open_and_compare() -> Any:
        connection = await genuine()
        certificate = connection.client.ctx.transport.get_extra_info("peercert")
        if ("IP Address", link._host) not in certificate["subjectAltName"]:
            link._end(connection)
            raise AdapterError("tls_error", "the certificate is of another host", outcome="not_sent")
        return connection

    link._open = open_and_compare  # type: ignore[method-assign]


@choice(
    "tells a handshake that failed as a connection that failed",
    "requirement TLS-002: the device is refused; the code of its own is recommended",
    checked_warnings=(("TLS-001", "wrong_error_code"), ("TLS-002", "wrong_error_code")),
)
def security_is_a_connection(server: AdapterServer) -> None:
    def change(call: Call, error: AdapterError) -> Exception | None:
        return AdapterError("connect_failed", error.message, outcome="not_sent") if error.code == "tls_error" else None

    failing(change=change)(server)
