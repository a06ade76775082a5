"""What the devices whose protocols have frames in a TCP stream have in common, seen by a raw socket."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Mapping
from functools import partial
from typing import Any, cast

import pytest
import pytest_asyncio
from mock_program import PATIENCE_S
from own_journal import OwnJournal
from pytest_otmcp.mocks.framed_connection import AnswerRule, FramedConnection
from pytest_otmcp.mocks.network import Mangling, Manner
from pytest_otmcp.mocks.tcp_device import TcpDevice

from pytest_otmcp.protocols.conversation import Direction, Message
from pytest_otmcp.wire.framing import MalformedError

pytestmark = pytest.mark.asyncio
BUFFER = 65_536
"""Bytes that the kernel keeps for each side of a connection, twice at the most; left to itself it may keep megabytes."""


class EchoDevice(TcpDevice):
    """A device whose frames are a length and so many bytes, which it sends back; 0xFF is no length, and ``!`` no content."""

    protocol = "echo"

    def __init__(self) -> None:
        super().__init__()
        self.rule: AnswerRule | None = None
        self.entries = OwnJournal(self.journal, EchoConversation)
        self.served: list[EchoConnection] = []
        self.full = asyncio.Event()
        """Set when a client has not read its answers for so long that they wait in the device."""

    def connection(self) -> asyncio.Protocol:
        self.served.append(EchoConnection(self))
        return self.served[-1]

    def image(self) -> dict[str, Any]:
        return {"points": {}}

    async def poke(self, params: Mapping[str, Any]) -> None:
        self.network.poke(params)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        return []

    async def reset(self) -> None: ...

    async def tick(self) -> None: ...


class EchoConnection(FramedConnection[EchoDevice]):
    garbage = b"\xff"

    def __init__(self, device: EchoDevice) -> None:
        super().__init__(device, frame_length)

    def frame(self, raw: bytes) -> None:
        if raw[1:] == b"!":
            raise MalformedError("an exclamation mark")
        asked = self.received(raw)
        send = partial(self.send, raw, asked, self.device.rule)
        if self.device.rule is None:
            send()
        else:
            self.misbehave(self.device.rule, send)

    def pause_writing(self) -> None:
        super().pause_writing()
        self.device.full.set()


class EchoConversation:
    """The decoder of one connection; it leaves it to the device to say what answers what."""

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        kind = "request" if direction == "in" else "response"
        return [Message(direction=direction, kind=kind, fields={"text": frame[1:].decode()}, request=kind == "request")]


def frame_length(buffer: bytes | bytearray) -> int | None:
    if buffer[0] == 0xFF:
        raise MalformedError("length 255")
    return 1 + buffer[0]


@pytest_asyncio.fixture
async def device() -> AsyncIterator[EchoDevice]:
    serving = EchoDevice()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setblocking(False)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
        serving.port = listener.getsockname()[1]
        await serving.serve({"echo": listener})
        yield serving
        await serving.aclose()
        await happened(serving, len(serving.entries.since(0, kind="CONNECTED")), kind="DISCONNECTED")


@contextlib.asynccontextmanager
async def client(device: EchoDevice) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    connecting = socket.socket()
    connecting.setblocking(False)
    connecting.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
    await asyncio.get_running_loop().sock_connect(connecting, ("127.0.0.1", device.port))
    reader, writer = await asyncio.open_connection(sock=connecting)
    try:
        yield reader, writer
    finally:
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()


async def happened(device: EchoDevice, count: int, **match: Any) -> list[Any]:
    found = await device.entries.wait(0, match, count, PATIENCE_S)
    assert len(found) == count
    return found


async def everything(reader: asyncio.StreamReader) -> bytes | None:
    """Return what comes before the end of the connection; None if that is a reset."""
    async with asyncio.timeout(PATIENCE_S):
        try:
            return await reader.read()
        except ConnectionResetError:
            return None


async def test_frames_come_in_pieces_and_together(device: EchoDevice) -> None:
    async with client(device) as (reader, writer):
        writer.write(b"\x03a")
        await writer.drain()
        # The answer to another client shows that the device has had its turn with half a frame, and made nothing of it.
        async with client(device) as (other_reader, other_writer):
            other_writer.write(b"\x01x")
            assert await other_reader.readexactly(2) == b"\x01x"
        writer.write(b"bc\x02de\x01f")
        assert await reader.readexactly(9) == b"\x03abc\x02de\x01f"
    asked = await happened(device, 4, kind="request")
    assert [(entry["connection"], entry["text"]) for entry in asked] == [(2, "x"), (1, "abc"), (1, "de"), (1, "f")]
    answered = await happened(device, 4, kind="response")
    assert [entry["answers"] for entry in answered] == [entry["seq"] for entry in asked]


@pytest.mark.parametrize(
    ("illegal", "reason"), [(b"\xffab", "length 255"), (b"\x01!", "an exclamation mark"), (b"\xff" * 400, "length 255")]
)
async def test_what_is_no_frame_ends_the_connection_and_what_follows_is_not_handled(
    device: EchoDevice, illegal: bytes, reason: str
) -> None:
    async with client(device) as (reader, writer):
        writer.write(b"\x01a" + illegal + b"\x01b")
        await everything(reader)
    await happened(device, 1, kind="DISCONNECTED")
    [malformed] = await happened(device, 1, kind="malformed")
    assert malformed["reason"] == reason
    assert malformed["bytes"] == (illegal + b"\x01b")[:300].hex()
    assert [entry["text"] for entry in await happened(device, 1, kind="request")] == ["a"]


async def test_an_end_inside_a_frame_is_recorded(device: EchoDevice) -> None:
    async with client(device) as (_, writer):
        writer.write(b"\x05ab")
    [malformed] = await happened(device, 1, kind="malformed")
    assert (malformed["bytes"], malformed["reason"]) == (b"\x05ab".hex(), "the connection ended inside a frame")


async def test_no_more_requests_are_read_from_a_client_that_reads_no_answers(device: EchoDevice) -> None:
    # These are two megabytes, many times what waits between the two programs when the device must stop.
    request, count = b"\xfe" + b"a" * 254, 8_000

    async def send(writer: asyncio.StreamWriter) -> None:
        for _ in range(count):
            writer.write(request)
            await writer.drain()

    async with client(device) as (reader, writer), asyncio.timeout(PATIENCE_S):
        # asyncio's client reads ahead, unless it is told not to.
        stream = cast(asyncio.Transport, writer.transport)
        stream.pause_reading()
        sending = asyncio.create_task(send(writer))
        await happened(device, 1, kind="CONNECTED")
        await device.full.wait()
        [link] = device.network.links
        assert not link.is_reading()
        assert len([entry for entry in device.entries.since(0) if entry["kind"] == "request"]) < count
        stream.resume_reading()
        assert await reader.readexactly(len(request) * count) == request * count
        await sending


RULES = {
    "drop": (AnswerRule(drop=True), b"", []),
    "close": (AnswerRule(close=True), b"", []),
    "reset": (AnswerRule(reset=True), None, []),
    "garbage": (AnswerRule(garbage=True), b"\xff", [("garbage", None, {"bytes": "ff"})]),
    "late": (AnswerRule(delay_s=0.01), b"\x01a", [("response", 1, {})]),
    "cut off": (AnswerRule(truncate=1), b"\x01", [("response", 1, {"truncate": 1})]),
    "byte by byte": (AnswerRule(manner=Manner(drip_s=0.01)), b"\x01a", [("response", 1, {"drip_s": 0.01})]),
    "twice": (
        AnswerRule(manner=Manner(duplicate=True)),
        b"\x01a\x01a",
        [("response", 1, {}), ("response", 1, {"duplicate": True})],
    ),
    "mangled twice": (
        AnswerRule(manner=Manner(duplicate=True, mangle=Mangling(append="00"))),
        b"\x01a\0\x01a\0",
        [("mangled", None, {"bytes": "016100"})] * 2,
    ),
}


@pytest.mark.parametrize("name", RULES)
async def test_an_answer_is_spoilt_as_a_rule_wants_it_and_the_journal_has_what_was_sent(
    device: EchoDevice, name: str
) -> None:
    device.rule, sent, recorded = RULES[name]
    async with client(device) as (reader, writer):
        writer.write(b"\x01a")
        await happened(device, 1, kind="request")
        if sent:
            assert await asyncio.wait_for(reader.readexactly(len(sent)), PATIENCE_S) == sent
        if not (device.rule.close or device.rule.reset):
            writer.write_eof()
        assert await everything(reader) == (None if sent is None else b"")
    await happened(device, 1, kind="DISCONNECTED")
    contract = {
        "seq",
        "t_ns",
        "connection",
        "direction",
        "kind",
        "request",
        "state_changing",
        "answers",
        "origin",
        "text",
        "frame",
        "told",
    }
    assert [
        (entry["kind"], entry["answers"], {key: value for key, value in entry.items() if key not in contract})
        for entry in device.entries.since(0)
        if entry["direction"] == "out"
    ] == recorded


async def test_what_cannot_be_sent_any_more_is_not_recorded_as_sent(device: EchoDevice) -> None:
    async with client(device) as (reader, _):
        await happened(device, 1, kind="CONNECTED")
        [connection] = device.served
        connection.send(b"\x01a", None)
        assert await asyncio.wait_for(reader.readexactly(2), PATIENCE_S) == b"\x01a"
    await happened(device, 1, kind="DISCONNECTED")
    connection.send(b"\x01b", None)
    async with client(device):
        await happened(device, 2, kind="CONNECTED")
        device.network.become("black_hole")
        device.served[1].send(b"\x01c", None)
    assert [entry["connection"] for entry in device.entries.since(0) if entry["kind"] == "response"] == [1]


async def test_a_late_answer_that_is_lost_is_not_recorded_as_sent(device: EchoDevice) -> None:
    device.rule = AnswerRule(delay_s=0.01)
    async with client(device):
        await happened(device, 1, kind="CONNECTED")
        [connection], [link] = device.served, device.network.links
        # The request and the end of the network are in one turn of the loop: the answer cannot be earlier.
        connection.frame(b"\x01a")
        device.network.become("black_hole")
        async with asyncio.timeout(PATIENCE_S):
            # The link is dead when the answer has been lost; nothing else tells of it.
            while not link.dead:  # noqa: ASYNC110
                await asyncio.sleep(0.001)
        device.network.become("open")
        # Who lost something stays dead, so nothing comes later either.
        connection.send(b"\x01b", None)
        assert device.entries.since(0, kind="response") == []
