"""Honest DNP3 adapters."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Callable
from typing import Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.defects.defect import Handler, wrap
from pytest_otmcp.reference_adapters.dnp3 import tools as dnp3_tools
from pytest_otmcp.reference_adapters.dnp3.connection import Connection, Response
from pytest_otmcp.reference_adapters.dnp3.conversions import exactly, shown
from pytest_otmcp.reference_adapters.dnp3.tools import Tools

from .choice import (
    again_after_silence,
    backed_off,
    background_call,
    choices,
    in_background,
    one_call_at_a_time,
    one_connection_per_call,
    said_to_ask,
    twice_where_missing,
)

__all__ = ["CHOICES"]

CHOICES, choice = choices("dnp3")


@choice(
    "has no pulses: latches, trips and closes alone, and refuses the other codes by itself",
    "which controls an adapter offers is its author's choice",
)
def no_pulses(server: AdapterServer) -> None:
    def without(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if arguments.control.startswith("pulse"):
                raise AdapterError("unsupported_operation", "outputs are not pulsed", field="/code", outcome="not_sent")
            return await genuine(call, arguments)

        return handler

    wrap(server, "write_binary_output", without)


@choice(
    "tells an event that came unasked in the answer to the read that it came before, and not once more with the next poll",
    "it is told once, as soon as there is an answer that can tell it",
)
def events_beside_a_read(server: AdapterServer) -> None:
    tools = server._tools["read_analog_inputs"].handler.__self__

    def with_unsolicited(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            return {**data, "unsolicited": [shown(one) for one in tools._link.kept(arguments.outstation_address)]}

        return handler

    listing = server._tools["read_analog_inputs"].listing
    wrap(server, "read_analog_inputs", with_unsolicited, listing=listing.model_copy(update={"output_schema": None}))


OUTSTATION = 10
READS = ("read_analog_inputs", "read_binary_inputs", "read_point_by_alias")
_READ, _WRITE, _ENABLE_UNSOLICITED, _DISABLE_UNSOLICITED, _RECORD_CURRENT_TIME = 1, 2, 20, 21, 24
_CLASS_0, _CLASSES = bytes([60, 1, 6]), bytes([60, 2, 6, 60, 3, 6, 60, 4, 6])
_INPUTS = ("binary_input", "analog_input")


def tools_of(server: AdapterServer) -> Tools:
    tools: Tools = server._tools["ping"].handler.__self__
    return tools


# -- connections ------------------------------------------------------------------------------------------------------


@choice("makes a connection for every call", "a connection is the adapter's own affair")
def connection_per_call(server: AdapterServer) -> None:
    one_connection_per_call(server, tools_of(server)._link.close)


@choice(
    "tries to connect again 1.5 s after it has failed", "requirement REC-001: back within recovery_s, by default 5 s"
)
def backs_off_for_1500_ms(server: AdapterServer) -> None:
    link = tools_of(server)._link
    link._connected = backed_off(link._connected, 1.5)


def after_connecting(server: AdapterServer, housekeeping: Callable[[Connection, Call], Any]) -> None:
    """Do this on every new connection, as a call of its own that is before the one which made it."""
    link = tools_of(server)._link
    genuine, done = link._step, [0]

    async def step(connection: Connection, call: Call, *arguments: Any) -> Response:
        if done[0] != link._generation:
            done[0] = link._generation
            own = background_call(server)
            await housekeeping(connection, own)
            call.attempts += own.attempts
        return await genuine(connection, call, *arguments)

    link._step = step


@choice(
    "switches unsolicited responses on with each connection",
    "IEEE 1815: which events are told unasked is between master and outstation",
)
def enables_unsolicited(server: AdapterServer) -> None:
    link = tools_of(server)._link
    after_connecting(server, lambda *used: link._send(*used, OUTSTATION, _ENABLE_UNSOLICITED, _CLASSES, False))


@choice(
    "switches unsolicited responses off with each connection",
    "IEEE 1815: which events are told unasked is between master and outstation",
)
def disables_unsolicited(server: AdapterServer) -> None:
    link = tools_of(server)._link
    after_connecting(server, lambda *used: link._send(*used, OUTSTATION, _DISABLE_UNSOLICITED, _CLASSES, False))


@choice(
    "sets the outstation's clock with each connection",
    "the clock of an outstation is its master's to set",
)
def sets_the_clock(server: AdapterServer) -> None:
    link = tools_of(server)._link

    async def synchronized(*used: Any) -> None:
        now = int(time.time() * 1000).to_bytes(6, "little")
        await link._send(*used, OUTSTATION, _RECORD_CURRENT_TIME, b"", False)
        await link._send(*used, OUTSTATION, _WRITE, bytes([50, 3, 7, 1]) + now, False)

    after_connecting(server, synchronized)


@choice("leaves the indication of a restart as it is", "who clears it is a matter of the station's masters")
def leaves_the_restart_bit(server: AdapterServer) -> None:
    tools_of(server)._link._clears_restart = False


@choice("asks for the status of the link twenty times a second", "a question for the link changes nothing")
def keep_alive_of_the_link(server: AdapterServer) -> None:
    link = tools_of(server)._link

    async def ask() -> None:
        await asyncio.sleep(0.05)
        await link.status(background_call(server), OUTSTATION)

    in_background(server, ask)


@choice("begins to count its requests at 14", "a sequence number is the master's, and comes back to 0 after 15")
def sequences_that_wrap(server: AdapterServer) -> None:
    tools_of(server)._link._sequences[OUTSTATION] = 13


choice("performs one call after the other", "the order of calls made at the same time is the adapter's own affair")(
    one_call_at_a_time
)


# -- reading ----------------------------------------------------------------------------------------------------------


def other_reads(server: AdapterServer, objects: bytes) -> None:
    """Let inputs be read by these objects, which have all of them; events among these are kept for the next poll."""
    tools = tools_of(server)
    genuine = tools._ask

    async def ask(call: Call, outstation: int, kind: str, start: int, count: int = 1, **more: Any) -> Response:
        if kind not in _INPUTS:
            return await genuine(call, outstation, kind, start, count, **more)
        response = await tools._link.ask(call, outstation, _READ, objects)
        tools._link._keep(outstation, [point for point in response.points if point.is_event])
        found = {point.index: point for point in response.points if point.kind == kind and not point.is_event}
        wanted = range(start, start + count)
        if not found.keys() >= set(wanted):
            raise AdapterError("illegal_address", "the outstation has no such points, or not all")
        return Response(
            blocks=response.blocks, points=[found[index] for index in wanted], indications=response.indications
        )

    tools._ask = ask


@choice("reads class 0 and answers the part", "the values are fresh; nobody forbids to read more at once")
def reads_class_0(server: AdapterServer) -> None:
    other_reads(server, _CLASS_0)


@choice(
    "reads inputs by an integrity poll, and keeps the events for the next poll",
    "an event is told once; a poll of all classes is the usual way to read an outstation",
)
def integrity_polls(server: AdapterServer) -> None:
    other_reads(server, _CLASSES + _CLASS_0)


@choice(
    "reads inputs by their indexes, one by one in a request", "IEEE 1815: qualifier 17 names each point by its index"
)
def reads_by_index(server: AdapterServer) -> None:
    def request(group: int, variation: int, start: int, stop: int) -> bytes:
        indexes = range(start, stop + 1)
        if stop > 0xFF or len(indexes) > 0xFF:
            return genuine(group, variation, start, stop)
        return bytes([group, variation, 0x17, len(indexes), *indexes])

    genuine = dnp3_tools.range_request
    dnp3_tools.range_request = request


@choice(
    "reads inputs by a request for each, and says that they are not of one moment",
    "requirement RD-007: a split read, with meta.atomic = false",
)
def reads_point_by_point(server: AdapterServer) -> None:
    tools = tools_of(server)
    genuine = tools._ask

    async def ask(call: Call, outstation: int, kind: str, start: int, count: int = 1, **more: Any) -> Response:
        parts = [await genuine(call, outstation, kind, index, 1, **more) for index in range(start, start + count)]
        if count > 1:
            call.extra["atomic"] = False
        indications = 0
        for part in parts:
            indications |= part.indications
        return Response(
            blocks=[block for part in parts for block in part.blocks],
            points=[point for part in parts for point in part.points],
            indications=indications,
        )

    tools._ask = ask


@choice(
    "reads a block of eight inputs and answers the part", "the values are fresh; nobody forbids to read more at once"
)
def block_reads(server: AdapterServer) -> None:
    tools = tools_of(server)
    genuine = tools._ask
    sizes = {"analog_input": 8, "binary_input": 16}

    async def ask(call: Call, outstation: int, kind: str, start: int, count: int = 1, **more: Any) -> Response:
        first, last = start // 8 * 8, -(-(start + count) // 8) * 8
        if last > sizes.get(kind, 0):
            return await genuine(call, outstation, kind, start, count, **more)
        whole = await genuine(call, outstation, kind, first, last - first, **more)
        held = exactly(whole, kind, range(first, last))
        points = [point for point in held if start <= point.index < start + count]
        return Response(blocks=whole.blocks, points=points, indications=whole.indications)

    tools._ask = ask


@choice("asks again when the outstation has no such points", "a read may be repeated; meta.attempts says so")
def asks_twice_for_missing_points(server: AdapterServer) -> None:
    for name in READS:
        wrap(server, name, twice_where_missing)


@choice(
    "waits half as long and reads a second time when the outstation was silent",
    "requirement TMO-002: a read may be repeated; meta.attempts says so",
    described=said_to_ask(2),
)
def reads_again_after_silence(server: AdapterServer) -> None:
    tools_of(server)._link._timeout_s /= 2
    again_after_silence(server, *READS, "ping")


@choice(
    "polls its events ten times a second, and tells them by the next poll that is asked for, oldest first",
    "an event is told once, as soon as there is an answer that can tell it",
)
def polls_events_in_background(server: AdapterServer) -> None:
    link = tools_of(server)._link

    async def poll() -> None:
        await asyncio.sleep(0.1)
        response = await link.ask(background_call(server), OUTSTATION, _READ, _CLASSES)
        link._keep(OUTSTATION, response.points)

    def oldest_first(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            data = await genuine(call, arguments)
            return {**data, "points": [*data["unsolicited"], *data["points"]], "unsolicited": []}

        return handler

    wrap(server, "poll_class", oldest_first)
    in_background(server, poll)


@choice("reads a binary input as a ping", "any answer of the outstation is one")
def ping_by_an_input(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def ping(call: Call, arguments: Any) -> dict[str, Any]:
        await tools._ask(call, OUTSTATION, "binary_input", 0)
        return {"reachable": True, "outstation_address": OUTSTATION}

    wrap(server, "ping", lambda genuine: ping)


# -- writing ----------------------------------------------------------------------------------------------------------


@choice(
    "sends a request again, byte by byte, when half of its time is over, a command too",
    "IEEE 1815, clause 4.2.2.4: an outstation knows a repeated request by its sequence number; meta.attempts says so",
    described=said_to_ask(2),
)
def repeats_with_its_sequence(server: AdapterServer) -> None:
    link = tools_of(server)._link
    send, calls = link._send, list[Call]()

    async def sending(connection: Connection, call: Call, *arguments: Any, **more: Any) -> Response:
        calls[:] = [call]
        return await send(connection, call, *arguments, **more)

    async def ask(self: Connection, *arguments: Any) -> Response:
        *request, timeout_s = arguments
        try:
            return await asked(self, *request, timeout_s / 2)
        except TimeoutError:
            calls[0].attempts += 1
            return await asked(self, *request, timeout_s / 2)

    asked = Connection.ask
    Connection.ask = ask
    link._send = sending


@choice("reads every output before it is operated", "reading changes nothing; meta.attempts says so")
def reads_before_operating(server: AdapterServer) -> None:
    tools = tools_of(server)
    genuine = tools._operate

    async def operate(call: Call, outstation: int, objects: bytes, **more: Any) -> int:
        kind = {12: "binary_output", 41: "analog_output"}[objects[0]]
        index = objects[4] if objects[2] == 0x17 else struct.unpack_from("<H", objects, 5)[0]
        try:
            await tools._ask(call, outstation, kind, index)
        except AdapterError as error:
            # A point that cannot be read may still be one that can be operated.
            if error.code not in ("illegal_address", "unsupported_operation", "protocol_error"):
                raise
        return await genuine(call, outstation, objects, **more)

    tools._operate = operate
