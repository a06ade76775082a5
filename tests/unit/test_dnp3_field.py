"""The second client for DNP3 at an outstation that behaves badly, and what it is asked for through an adapter."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest

from pytest_otmcp.plant.field_device import UnreachableError
from pytest_otmcp.plant.field_dnp3 import Dnp3Client
from pytest_otmcp.protocols.dnp3.decoder import Dnp3Conversation
from pytest_otmcp.protocols.dnp3.field import FIELD
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.wire.dnp3.application import RESPONSE, UNSOLICITED_RESPONSE, Request
from pytest_otmcp.wire.dnp3.link import LINK_STATUS, UNCONFIRMED_USER_DATA, LinkFrame, link_length, segments
from pytest_otmcp.wire.framing import Framer

asynchronous = pytest.mark.asyncio


def sent(fragment: bytes, *, source: int = 10, destination: int = 1, **more: Any) -> bytes:
    given = {"function": UNCONFIRMED_USER_DATA, "primary": True, "from_master": False, **more}
    parts = segments(fragment, 0) if fragment else [b""]
    return b"".join(LinkFrame(source=source, destination=destination, data=part, **given).encoded() for part in parts)


class Outstation:
    """Has analog inputs alone, whose flags are given: it repeats its answer to a request with the number of the one before."""

    def __init__(self) -> None:
        self.values = [-5, 7, 9]
        self.flags = [1, 1, 1]
        self.float = 5
        self.last: tuple[int, bytes] = (-1, b"")
        self.before: Callable[[int], bytes] = lambda sequence: b""
        self.serving: set[asyncio.Task[None] | None] = set()

    def answer(self, request: Request) -> bytes:
        (header,) = request.headers
        assert header.start is not None
        assert header.stop is not None
        indexes = [index for index in range(header.start, header.stop + 1) if index < len(self.values)]
        objects = b""
        if indexes and header.group == 30:
            form = "<Bf" if header.variation == self.float else "<Bi"
            objects = bytes([30, 5 if form == "<Bf" else 1, 0, indexes[0], indexes[-1]])
            objects += b"".join(struct.pack(form, self.flags[index], self.values[index]) for index in indexes)
        iin = 0 if len(indexes) > header.stop - header.start else 0x0400
        return bytes([0xC0 | request.sequence, RESPONSE]) + iin.to_bytes(2, "little") + objects

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.serving.add(asyncio.current_task())
        framer = Framer(link_length)
        while data := await reader.read(4096):
            for frame in framer.feed(data):
                request = Request.parse(LinkFrame.parse(frame).data[1:])
                if request.sequence != self.last[0]:
                    self.last = (request.sequence, self.answer(request))
                writer.write(self.before(request.sequence) + sent(self.last[1]))
        writer.close()


@asynccontextmanager
async def surveyed() -> AsyncIterator[tuple[Outstation, Dnp3Client]]:
    outstation = Outstation()
    server = await asyncio.start_server(outstation.serve, "127.0.0.1", 0)
    client = Dnp3Client("127.0.0.1", server.sockets[0].getsockname()[1])
    try:
        assert await client.survey() == {"analog_input": (10, 65535)}
        yield outstation, client
    finally:
        server.close()
        await asyncio.wait_for(asyncio.gather(*(task for task in outstation.serving if task)), 60)


@asynchronous
async def test_an_answer_to_another_client_is_not_taken_for_the_own_one() -> None:
    async with surveyed() as (outstation, client):
        stale = bytes([RESPONSE, 0, 0, 30, 1, 0, 0, 2]) + struct.pack("<BiBiBi", 1, 1, 1, 1, 1, 1)
        sequence = (client._sequence + 1) % 16
        outstation.last = (sequence, bytes([0xC0 | sequence]) + stale)
        assert list((await client.values()).values()) == [-5, 7, 9]


@asynchronous
async def test_what_else_an_outstation_sends_is_passed_over() -> None:
    def before(sequence: int) -> bytes:
        wrong = bytes([0, 0, 30, 1, 0, 0, 0]) + struct.pack("<Bi", 1, 1)
        return b"".join(
            (
                sent(b"", function=LINK_STATUS, primary=False),
                sent(bytes([0xF0 | sequence, UNSOLICITED_RESPONSE]) + wrong),
                sent(bytes([0xC0 | (sequence - 1) % 16, RESPONSE]) + wrong),
                sent(bytes([0xC0 | sequence, RESPONSE]) + wrong, source=11),
                sent(bytes([0xC0 | sequence, RESPONSE]) + wrong, destination=2),
            )
        )

    async with surveyed() as (outstation, client):
        outstation.before = before
        assert list((await client.values()).values()) == [-5, 7, 9]


@asynchronous
@pytest.mark.parametrize("flags", [0, 2, 3, 5, 9, 17, 33])
async def test_a_point_that_is_not_vouched_for_any_more_is_no_value(flags: int) -> None:
    async with surveyed() as (outstation, client):
        outstation.flags[1] = flags
        with pytest.raises(UnreachableError, match="does not vouch for 10/analog_input/1 any more"):
            await client.values()


@asynchronous
@pytest.mark.parametrize(
    "answer", [bytes(12), sent(b"\xc0\x81\0\0")[:-1] + b"\0", sent(b"\xc0\x01\0\0"), sent(b"\x80\x81\0\0")]
)
async def test_what_is_no_answer_is_told(answer: bytes) -> None:
    async with surveyed() as (outstation, client):
        outstation.before = lambda sequence: answer
        with pytest.raises(UnreachableError, match="DNP3"):
            await client.values()


def test_a_read_of_another_outstation_is_no_read_of_this_one() -> None:
    def entries(outstation: int) -> list[Any]:
        talk = Dnp3Conversation()
        read = sent(b"\xc0\x01\x1e\0\0\1\2", source=1, destination=outstation, from_master=True)
        told = sent(b"\xc0\x81\0\0\x1e\3\0\1\2" + bytes(8), source=outstation)
        (asked,), (answer,) = talk.decode("in", read), talk.decode("out", told)
        common = {"connection": 1, "state_changing": False}
        return [
            {"seq": 0, "kind": asked.kind, "request": True, "answers": None, **common, **asked.fields},
            {"seq": 1, "kind": answer.kind, "request": False, "answers": 0, **common, **answer.fields},
        ]

    points = {f"10/analog_input/{index}": 0 for index in (1, 2)}
    asked = Asked(operation="read_analog", inputs={}, points=points)
    assert FIELD.was_read(entries(10), asked) == []
    assert [finding.code for finding in FIELD.was_read(entries(11), asked)] == ["no_exchange"]
    assert FIELD.sent(entries(10)) == [0, 0]


def test_values_that_differ_are_asked_for_one_by_one_then_some_beside_one_another() -> None:
    held = dict(enumerate([5, 5, -2, 5, 9, 5, 7]))
    image: Any = {
        "points": {f"3/analog_input/{index}": value for index, value in held.items()}
        | {"3/binary_input/4": True, "3/binary_input/5": False, "3/binary_input/7": True},
        "beyond": {"binary_input": (3, 9999)},
    }
    reads = FIELD.reads(image, lambda operation: True)
    assert [(one.operation, *one.inputs.values(), one.outputs["values"]) for one in reads] == [
        ("read_analog", 3, 0, 1, [5]),
        ("read_analog", 3, 2, 1, [-2]),
        ("read_analog", 3, 4, 1, [9]),
        ("read_binary", 3, 4, 1, [True]),
        ("read_binary", 3, 5, 1, [False]),
        ("read_analog", 3, 0, 4, [5, 5, -2, 5]),
        ("read_binary", 3, 4, 2, [True, False]),
    ]
    beyond = FIELD.beyond(image, lambda operation: True)
    assert beyond is not None
    assert beyond.inputs == {"outstation": 3, "start": 9999, "count": 1}
    assert FIELD.beyond(image, lambda operation: operation == "read_analog") is None
    assert {one.operation for one in FIELD.reads(image, lambda operation: operation != "read_analog")} == {
        "read_binary"
    }
