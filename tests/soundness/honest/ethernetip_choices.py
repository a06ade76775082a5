"""Honest EtherNet/IP adapters."""

from __future__ import annotations

import asyncio
import dataclasses
import re
import struct
from typing import Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.core import bounds as core_bounds
from pytest_otmcp.reference_adapters.core import policy as core_policy
from pytest_otmcp.reference_adapters.defects.defect import Handler, wrap
from pytest_otmcp.reference_adapters.ethernetip import link as ethernetip_link
from pytest_otmcp.reference_adapters.ethernetip import tools as ethernetip_tools
from pytest_otmcp.reference_adapters.ethernetip.connection import SEND_RR_DATA, Connection, next_frame
from pytest_otmcp.reference_adapters.ethernetip.link import Link
from pytest_otmcp.reference_adapters.ethernetip.shapes import TagListOf
from pytest_otmcp.reference_adapters.ethernetip.tools import Tools
from pytest_otmcp.reference_adapters.ethernetip.wire import (
    FORWARD_OPEN,
    Reply,
    read_service,
    unconnected_message,
)

from .choice import (
    POLLING_BESIDE_CALLS,
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

CHOICES, choice = choices("ethernetip")

READS = ("read_tag", "read_array", "read_tag_by_alias")
_LIST_IDENTITY, _NOP = 0x63, 0x00
_UNCONNECTED_SEND_PATH = bytes.fromhex("20062401")
_SUCCESS, _PARTLY = 0x00, 0x06


def tools_of(server: AdapterServer) -> Tools:
    tools: Tools = server._tools["ping"].handler.__self__
    return tools


# -- connections ------------------------------------------------------------------------------------------------------


def without_connections(server: AdapterServer, slot: int | None) -> None:
    """Let the adapter send its requests outside of CIP connections, to the controller in this slot or to the device itself."""
    link = tools_of(server)._link
    sent = link._sent

    async def opened(connection: Connection) -> None:
        connection.size = 504

    def frame(request: bytes) -> bytes:
        message = request
        if slot is not None:
            padded = request + bytes(len(request) % 2)
            head = bytes([0x52, 2]) + _UNCONNECTED_SEND_PATH + struct.pack("<BBH", 0x07, 0xE9, len(request))
            message = head + padded + bytes([1, 0, 1, slot])
        return bytes(link._frames._build_rr_data_header(len(message))) + message

    async def answer(connection: Connection, frame: bytes, sequence: int) -> bytes:
        connection.writer.write(frame)
        await connection.writer.drain()
        return unconnected_message((await next_frame(connection, SEND_RR_DATA))[1])

    async def one(connection: Connection, call: Call, *arguments: Any) -> Reply:
        try:
            return await sent(connection, call, *arguments)
        finally:
            call.trace.pop("sequences", None)

    async def close() -> None:
        link._drop(link._connection)

    link._forward_open, link._sent = opened, one
    link._frames._build_eip_header = frame
    ethernetip_link.answer = answer
    server._close = close


@choice(
    "sends its requests outside of CIP connections, to the device itself",
    "a controller answers unconnected messages as well as connected ones",
)
def unconnected_messages(server: AdapterServer) -> None:
    without_connections(server, None)


@choice(
    "sends its requests outside of CIP connections, by Unconnected Send to the controller's slot",
    "a controller in a chassis is reached over the backplane",
)
def unconnected_send(server: AdapterServer) -> None:
    without_connections(server, tools_of(server)._link._slot)


@choice("opens and closes a CIP connection for every call", "a connection is the adapter's own affair")
def connection_per_call(server: AdapterServer) -> None:
    one_connection_per_call(server, tools_of(server)._link.close)


@choice(
    "opens connections of the usual size only",
    "the size of a connection is agreed on; not every controller has large ones",
)
def usual_connections(server: AdapterServer) -> None:
    ethernetip_link._SIZES = {FORWARD_OPEN: 504}


@choice(
    "asks for the device's identity before it registers a session", "List Identity needs no session and changes nothing"
)
def lists_identity_first(server: AdapterServer) -> None:
    link = tools_of(server)._link
    register = link._register

    async def register_later(connection: Connection) -> None:
        connection.writer.write(link._frames._build_list_identity())
        await next_frame(connection, _LIST_IDENTITY)
        await register(connection)

    link._register = register_later


@choice("writes over a second connection", "a connection is the adapter's own affair; a controller has several")
def connection_for_writing(server: AdapterServer) -> None:
    reading = tools_of(server)
    link = reading._link
    writing = Link(link._host, link._port, link._slot, link._timeout_s)
    writer = Tools(writing, aliases=reading._aliases, control_enabled=reading._control_enabled)
    for name in ("write_tag", "write_array", "write_tag_by_alias"):
        server._tools[name] = dataclasses.replace(server._tools[name], handler=getattr(writer, name))

    async def close_both() -> None:
        await link.close()
        await writing.close()

    server._close = close_both


@choice(
    "tries to connect again 1.5 s after it has failed", "requirement REC-001: back within recovery_s, by default 5 s"
)
def backs_off_for_1500_ms(server: AdapterServer) -> None:
    link = tools_of(server)._link
    link._connected = backed_off(link._connected, 1.5)


@choice("sends a NOP twenty times a second, to keep the connection", "a NOP is not answered and changes nothing")
def keep_alive_frames(server: AdapterServer) -> None:
    link = tools_of(server)._link

    async def nop() -> None:
        await asyncio.sleep(0.05)
        connection = link._connection
        if connection is not None and not connection.is_used_up():
            connection.writer.write(struct.pack("<HHII8sI", _NOP, 0, 0, 0, b"", 0))

    in_background(server, nop)


@choice("begins to count its requests at 65,530", "a sequence count is the client's, and comes back to 0 after 65,535")
def sequences_that_wrap(server: AdapterServer) -> None:
    tools_of(server)._link._frames._sequence_counter = 65_530


choice("performs one call after the other", "the order of calls made at the same time is the adapter's own affair")(
    one_call_at_a_time
)


# -- naming -----------------------------------------------------------------------------------------------------------


@choice("names tags in capital letters", "names of tags are the same in any case")
def names_in_capitals(server: AdapterServer) -> None:
    genuine = ethernetip_tools._target
    ethernetip_tools._target = lambda name: genuine(name.upper())
    covers = core_bounds.covers

    def in_any_case(pattern: str, target: str) -> bool:
        return covers(pattern.upper(), target.upper())

    core_bounds.covers = core_policy.covers = in_any_case


@choice(
    "names a tag by the instance of its symbol, which it has read from the controller, and tells its name in the trace",
    "Rockwell 1756-PM020: an instance stands for a name",
)
def symbol_instances(server: AdapterServer) -> None:
    tools = tools_of(server)
    known: dict[str, int] = {}
    path_of = tools._path

    async def learn(call: Call) -> None:
        builder, first = tools._link.builder, 0
        while True:
            builder.Offset = first
            request = builder._build_tag_list_request(None)
            reply = await tools._link.exchange(call, request, changes_state=False)
            if reply.status not in (_SUCCESS, _PARTLY):
                raise AdapterError("protocol_error", "the controller does not list its tags", outcome="not_sent")
            data = reply.data
            while len(data) >= 20:
                (instance, length) = struct.unpack_from("<IH", data)
                known[data[6 : 6 + length].decode("latin-1").lower()] = instance
                data, first = data[20 + length :], instance + 1
            if reply.status == _SUCCESS:
                return

    def path(target: Any) -> bytes:
        name, rest = re.fullmatch(r"([^.\[]*)(.*)", target.name.lower()).groups()  # type: ignore[union-attr]
        element = re.fullmatch(r"(?:\[([0-9]+)\])?", rest)
        if name not in known or element is None:
            return path_of(target)
        named = struct.pack("<BBBBH", 0x20, 0x6B, 0x25, 0, known[name])
        return named if element[1] is None else named + struct.pack("<BBH", 0x29, 0, int(element[1]))

    def learning(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            if not known:
                await learn(call)
            return await genuine(call, arguments)

        return handler

    tools._path = path
    for name in (*READS, "write_tag", "write_array", "write_tag_by_alias"):
        wrap(server, name, learning)


# -- reading ----------------------------------------------------------------------------------------------------------


@choice("reads by Read Tag Fragmented", "Rockwell 1756-PM020: a fragment from 0 on is the whole, where it fits")
def fragmented_reads(server: AdapterServer) -> None:
    ethernetip_tools.read_service = lambda path, count: (
        bytes([0x52, len(path) // 2]) + path + struct.pack("<HI", count, 0)
    )


@choice("reads a second tag with every tag, by one request", "reading more than was asked for changes nothing")
def reads_with_another_tag(server: AdapterServer) -> None:
    tools = tools_of(server)
    other = ethernetip_tools._target("MotorSpeed")

    async def value(call: Call, name: str) -> Any:
        target = ethernetip_tools._target(name)
        reply, _ = await tools._read_all(call, [target, other])
        if reply.status != _SUCCESS:
            raise ethernetip_tools.refusal(call, reply.status, reply.extended)
        return {"tag_name": name, **ethernetip_tools._told(call, "/data/value", tools._decoded(call, target, reply))}

    tools._value = value


@choice(
    "reads the elements of an array one by one, and says that they are not of one moment",
    "requirement RD-007: a split read, with meta.atomic = false",
)
def elements_one_by_one(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def read(call: Call, arguments: Any) -> Any:
        found = re.fullmatch(r"(.*)\[([0-9]+)\]", arguments.tag_name)
        name, first = (arguments.tag_name, 0) if found is None else (found[1], int(found[2]))
        values = [await tools._value(call, f"{name}[{first + place}]") for place in range(arguments.elements)]
        if arguments.elements > 1:
            call.extra["atomic"] = False
        return {
            "tag_name": arguments.tag_name,
            "type": values[0]["type"],
            "values": [value["value"] for value in values],
            "specials": [value["special"] for value in values],
            "raw": "".join(value["raw"] for value in values),
        }

    wrap(server, "read_array", lambda genuine: read)


@choice(
    "lists the controller's tags before it reads one, and refuses by itself what is not among them",
    "a refusal that reaches no device is as good as the device's",
)
def lists_before_reading(server: AdapterServer) -> None:
    tools = tools_of(server)

    def looked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            question = background_call(server)
            try:
                listed = await tools.get_tag_list(question, TagListOf())
            finally:
                call.attempts += question.attempts
                call._used, call.trace = question._used, question.trace
            name = re.split(r"[.\[]", arguments.tag_name)[0].lower()
            if name not in {one["tag_name"].lower() for one in listed["tags"]} and ":" not in name:
                raise AdapterError("illegal_address", "the controller lists no such tag", outcome="not_applicable")
            return await genuine(call, arguments)

        return handler

    for name in ("read_tag", "read_array"):
        wrap(server, name, looked)


@choice("asks again when the controller has no such tag", "a read may be repeated; meta.attempts says so")
def asks_twice_for_a_missing_tag(server: AdapterServer) -> None:
    for name in READS:
        wrap(server, name, twice_where_missing)


@choice(
    "waits half as long and reads a second time when the controller was silent",
    "requirement TMO-002: a read may be repeated; meta.attempts says so",
    described=said_to_ask(2),
)
def reads_again_after_silence(server: AdapterServer) -> None:
    tools_of(server)._link._timeout_s /= 2
    again_after_silence(server, *READS, "ping")


@choice(
    "polls the tags that the tasks read, fifty times a second", "nobody forbids polling", described=POLLING_BESIDE_CALLS
)
def polls_the_same_tags(server: AdapterServer) -> None:
    tools = tools_of(server)

    async def poll() -> None:
        await asyncio.sleep(0.02)
        for name in ("MotorSpeed", "ValvePosition"):
            await tools._value(background_call(server), name)

    in_background(server, poll)


# -- writing ----------------------------------------------------------------------------------------------------------


@choice("asks for the type of a tag before every write", "reading changes nothing; meta.attempts says so")
def asks_for_the_type_each_time(server: AdapterServer) -> None:
    tools = tools_of(server)
    learn = tools._learn

    async def anew(call: Call, targets: Any) -> None:
        tools._types.clear()
        await learn(call, targets)

    tools._learn = anew


@choice(
    "reads every tag back after it was written, and tells what the controller holds",
    "reading changes nothing; meta.attempts says so",
)
def reads_back_after_writing(server: AdapterServer) -> None:
    tools = tools_of(server)
    genuine = tools._write

    async def write(call: Call, name: str, value: Any, wanted: Any = None) -> Any:
        written = await genuine(call, name, value, wanted)
        trace = {key: call.trace[key] for key in call.trace if key != "sequences"}
        target = ethernetip_tools._target(name)
        reply = await tools._link.exchange(
            call, read_service(tools._path(target), 1), tag=target.name, changes_state=False
        )
        if reply.status != _SUCCESS:
            raise AdapterError("verify_failed", "the tag could not be read back", outcome="unknown")
        call.trace |= trace
        return {**written, "value": tools._decoded(call, target, reply)["value"]}

    tools._write = write
