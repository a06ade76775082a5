"""The tap against a real echo server: what passes, what is recorded, and each fault it can inject."""

from __future__ import annotations

import asyncio
import random
import socket
from collections.abc import AsyncIterator, Awaitable
from contextlib import asynccontextmanager
from typing import TypeVar

import pytest

from pytest_otmcp.plant.tap.faults import Action, FaultRule
from pytest_otmcp.plant.tap.stream import StreamTap
from pytest_otmcp.protocols.registry import protocols

pytestmark = pytest.mark.asyncio

Received = TypeVar("Received")

READ = bytes.fromhex("0001 0000 0006 01 03 006B 0003")
OTHER = bytes.fromhex("0002 0000 0006 01 03 0000 0001")


class Echo(asyncio.Protocol):
    """A server that sends back what it gets, under back pressure, and ends its side when the client ends its own."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.transport.write(data)

    def pause_writing(self) -> None:
        self.transport.pause_reading()

    def resume_writing(self) -> None:
        self.transport.resume_reading()


@asynccontextmanager
async def echo() -> AsyncIterator[int]:
    server = await asyncio.get_running_loop().create_server(Echo, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()


@asynccontextmanager
async def tapped(protocol: str | None = "modbus") -> AsyncIterator[StreamTap]:
    async with echo() as port:
        tap = StreamTap("127.0.0.1", port, framing=None if protocol is None else protocols()[protocol].framing)
        await tap.start()
        try:
            yield tap
        finally:
            await tap.aclose()
            assert tap.open_connections == 0
            assert not [task for task in asyncio.all_tasks() if task.get_name().startswith("otmcp-tap")]


@asynccontextmanager
async def client(tap: StreamTap) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection("127.0.0.1", tap.port)
    try:
        yield reader, writer
    finally:
        writer.transport.abort()


async def soon(awaitable: Awaitable[Received]) -> Received:
    """Wait for what must happen; the limit only keeps a broken tap from hanging the tests."""
    return await asyncio.wait_for(awaitable, 60)


async def test_a_megabyte_passes_unchanged_in_both_directions() -> None:
    data = random.Random(1).randbytes(1 << 20)
    async with tapped(None) as tap, client(tap) as (reader, writer):
        writer.write(data)
        writer.write_eof()
        assert await soon(reader.read(-1)) == data


async def test_a_slow_reader_slows_the_sender_down_and_loses_nothing() -> None:
    data = random.Random(2).randbytes(8 << 20)
    async with tapped(None) as tap, client(tap) as (reader, writer):
        writer.write(data)
        writer.write_eof()
        received = bytearray()
        while piece := await soon(reader.read(50_000)):
            received += piece
            await asyncio.sleep(0)
    assert bytes(received) == data


async def test_small_pieces_are_sent_at_once_in_both_directions() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        writer.write(READ)
        await soon(reader.readexactly(12))
        (link,) = tap._links
        for side in (link.client, link.device):
            assert side.transport is not None
            sock = side.transport.get_extra_info("socket")
            assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


async def test_a_half_closed_connection_still_delivers_the_answer() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        writer.write(READ)
        writer.write_eof()
        assert await soon(reader.read(-1)) == READ
        await tap.journal.wait(0, {"kind": "DISCONNECTED"}, 1, 60.0)
        assert tap.open_connections == 0


async def test_what_a_client_sends_before_the_device_is_connected_is_not_lost() -> None:
    async with tapped() as tap:
        sock = socket.create_connection(("127.0.0.1", tap.port))
        sock.sendall(READ + OTHER)
        sock.setblocking(False)
        received = b""
        while len(received) < 24:
            received += await soon(asyncio.get_running_loop().sock_recv(sock, 100))
        sock.close()
    assert received == READ + OTHER


async def test_frames_are_on_the_journal_in_the_shape_of_a_mock() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        writer.write(READ[:5])
        writer.write(READ[5:] + OTHER)
        await soon(reader.readexactly(24))
        entries = tap.journal.since(0)
    assert [(entry["seq"], entry["connection"], entry["direction"], entry["kind"]) for entry in entries] == [
        (0, 1, "in", "CONNECTED"),
        (1, 1, "in", "request"),
        (2, 1, "in", "request"),
        (3, 1, "out", "response"),
        (4, 1, "out", "response"),
    ]
    assert (entries[1]["function"], entries[1]["address"], entries[1]["quantity"]) == (3, 0x6B, 3)
    assert [entry["t_ns"] for entry in entries] == sorted(entry["t_ns"] for entry in entries)


async def test_the_journal_can_be_awaited_and_sliced() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        waiting = asyncio.create_task(tap.journal.wait(0, {"kind": "request"}, 2, 60.0))
        writer.write(READ)
        await soon(reader.readexactly(12))
        assert not waiting.done()
        mark = tap.journal.next
        writer.write(OTHER)
        assert [entry["address"] for entry in await waiting] == [0x6B, 0]
        await soon(reader.readexactly(12))
        assert [entry["kind"] for entry in tap.journal.since(mark)] == ["request", "response"]


async def test_down_resets_and_refuses_and_up_accepts_on_the_same_port() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        port = tap.port
        writer.write(READ)
        await soon(reader.readexactly(12))
        await tap.down()
        with pytest.raises(ConnectionResetError):
            await soon(reader.read(1))
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection("127.0.0.1", port)
        await tap.up()
        assert tap.port == port
        async with client(tap) as (again, write_again):
            write_again.write(READ)
            assert await soon(again.readexactly(12)) == READ
        assert tap.journal.since(0)[-1]["connection"] == 2


async def test_a_connection_that_comes_in_the_moment_of_going_down_is_reset_too() -> None:
    async with tapped() as tap:
        going: list[asyncio.Task[None]] = []
        accept = tap._accept

        def accept_and_go_down() -> asyncio.BaseProtocol:
            going.append(asyncio.create_task(tap.down()))
            return accept()

        await tap.down()
        tap._accept = accept_and_go_down  # type: ignore[method-assign, assignment]
        await tap.up()
        async with client(tap) as (reader, _):
            with pytest.raises(ConnectionResetError):
                await soon(reader.read(1))
            await soon(asyncio.gather(*going))
        assert tap.open_connections == 0


async def test_a_device_that_refuses_makes_the_tap_reset() -> None:
    unused = socket.socket()
    unused.bind(("127.0.0.1", 0))
    tap = StreamTap(*unused.getsockname(), framing=protocols()["modbus"].framing)
    await tap.start()
    async with client(tap) as (reader, _):
        with pytest.raises(ConnectionResetError):
            await soon(reader.read(1))
    await tap.aclose()
    unused.close()


async def test_closing_the_tap_while_it_connects_leaves_nothing_behind() -> None:
    # TEST-NET-1 never answers; where the route refuses at once, the tap resets, which the test accepts too.
    tap = StreamTap("192.0.2.1", 9, framing=protocols()["modbus"].framing)
    await tap.start()
    async with client(tap):
        await tap.journal.wait(0, {"kind": "CONNECTED"}, 1, 60.0)
        await tap.aclose()
    assert tap.open_connections == 0


async def test_a_refused_connection_is_reset_and_the_next_one_works() -> None:
    async with tapped() as tap:
        tap.inject(FaultRule(action=Action.REFUSE, frame=2))
        async with client(tap) as (reader, writer):
            writer.write(READ)
            assert await soon(reader.readexactly(12)) == READ
        async with client(tap) as (reader, _):
            with pytest.raises(ConnectionResetError):
                await soon(reader.read(1))
        async with client(tap) as (reader, writer):
            writer.write(READ)
            assert await soon(reader.readexactly(12)) == READ
        assert tap.injected == {Action.REFUSE: 1}


async def test_reset_comes_instead_of_the_second_answer() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        tap.inject(FaultRule(action=Action.RESET, direction="out", frame=2))
        writer.write(READ)
        assert await soon(reader.readexactly(12)) == READ
        writer.write(OTHER)
        with pytest.raises(ConnectionResetError):
            await soon(reader.readexactly(12))
        assert tap.injected == {Action.RESET: 1}
        assert [entry["fault"] for entry in tap.journal.since(0) if "fault" in entry] == ["reset"]


async def test_a_black_hole_swallows_both_directions_and_leaves_other_connections_alone() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        tap.inject(FaultRule(action=Action.BLACK_HOLE, direction="in", connection=1))
        writer.write(READ)
        writer.write(OTHER)
        async with client(tap) as (other, write_other):
            write_other.write(READ)
            assert await soon(other.readexactly(12)) == READ
        assert not reader.at_eof()
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(reader.read(1), 0.05)
        assert tap.injected == {Action.BLACK_HOLE: 1}


async def test_a_delayed_frame_keeps_its_place_before_later_ones() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        tap.inject(FaultRule(action=Action.DELAY, direction="in", seconds=0.05))
        began = asyncio.get_running_loop().time()
        writer.write(READ + OTHER)
        assert await soon(reader.readexactly(24)) == READ + OTHER
        # A lower bound is no measurement of performance: the frame cannot have come earlier.
        assert asyncio.get_running_loop().time() - began >= 0.045
        assert tap.injected == {Action.DELAY: 1}


async def test_the_end_of_the_stream_waits_for_delayed_frames() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        tap.inject(FaultRule(action=Action.DELAY, direction="in", seconds=0.05))
        writer.write(READ + OTHER[:3])
        writer.write_eof()
        assert await soon(reader.read(-1)) == READ + OTHER[:3]


async def test_a_dripping_answer_arrives_byte_by_byte() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        tap.inject(FaultRule(action=Action.DRIP, direction="out", seconds=0.002))
        writer.write(READ + OTHER)
        pieces: list[bytes] = []
        while sum(map(len, pieces)) < 24:
            piece = await soon(reader.read(100))
            pieces.append(piece)
        assert b"".join(pieces) == READ + OTHER
        assert len(pieces) >= 6
        assert tap.injected == {Action.DRIP: 1}


async def test_a_dropped_answer_is_missing_and_the_next_one_comes() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        tap.inject(FaultRule(action=Action.DROP, direction="out"))
        writer.write(READ + OTHER)
        assert await soon(reader.readexactly(12)) == OTHER
        assert tap.injected == {Action.DROP: 1}


async def test_truncate_passes_only_the_beginning() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        tap.inject(FaultRule(action=Action.TRUNCATE, direction="out", length=7))
        writer.write(READ + OTHER)
        assert await soon(reader.readexactly(19)) == READ[:7] + OTHER


async def test_corrupt_changes_one_byte_of_the_chosen_frame() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        tap.inject(FaultRule(action=Action.CORRUPT, direction="out", frame=2, offset=-1, mask=0x0F))
        writer.write(READ + OTHER)
        assert await soon(reader.readexactly(24)) == READ + OTHER[:-1] + bytes([OTHER[-1] ^ 0x0F])


async def test_duplicate_and_reorder_move_whole_frames() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        tap.inject(FaultRule(action=Action.DUPLICATE, direction="in"))
        writer.write(READ + OTHER)
        assert await soon(reader.readexactly(36)) == READ + READ + OTHER
        tap.inject(FaultRule(action=Action.REORDER, direction="in"))
        writer.write(READ + OTHER)
        assert await soon(reader.readexactly(24)) == OTHER + READ


async def test_rules_hit_the_same_frames_however_the_bytes_are_cut_into_segments() -> None:
    frames = [index.to_bytes(2) + READ[2:] for index in range(1, 21)]
    expected = frames[:6] + [frames[7], frames[6]] + [frames[8]] * 2 + frames[9:]
    rng = random.Random(3)
    for _ in range(5):
        async with tapped() as tap, client(tap) as (reader, writer):
            tap.inject(
                FaultRule(action=Action.REORDER, direction="in", frame=7),
                FaultRule(action=Action.DUPLICATE, direction="in", frame=9),
            )
            stream = b"".join(frames)
            while stream:
                size = rng.choice((1, 2, 5, 12, 30))
                writer.write(stream[:size])
                await writer.drain()
                await asyncio.sleep(0)
                stream = stream[size:]
            assert await soon(reader.readexactly(12 * 21)) == b"".join(expected)


async def test_plans_may_change_in_the_middle_of_a_frame() -> None:
    async with tapped() as tap, client(tap) as (reader, writer):
        writer.write(READ[:4])
        assert await soon(reader.readexactly(4)) == READ[:4]
        tap.inject(FaultRule(action=Action.CORRUPT, direction="in", offset=1))
        writer.write(READ[4:] + OTHER + READ[:6])
        # The frame that had begun before the plan is left alone; the next frame is the first one of the plan.
        assert await soon(reader.readexactly(20)) == READ[4:] + bytes([0, OTHER[1] ^ 0xFF]) + OTHER[2:]
        tap.inject()
        writer.write(READ[6:])
        assert await soon(reader.readexactly(12)) == READ


async def test_bytes_that_are_no_frames_pass_and_are_noted_once() -> None:
    garbage = bytes.fromhex("0001 dead 0006 01 03 0000 0001")
    async with tapped() as tap, client(tap) as (reader, writer):
        writer.write(READ + garbage + garbage)
        assert await soon(reader.readexactly(36)) == READ + garbage + garbage
        tap.inject(FaultRule(action=Action.DUPLICATE, direction="out"))
        writer.write(b"more")
        assert await soon(reader.readexactly(8)) == b"moremore"
        malformed = [entry for entry in tap.journal.since(0) if entry["kind"] == "malformed"]
    assert [entry["direction"] for entry in malformed] == ["in", "out"]
    assert malformed[0]["reason"] == "the protocol identifier is 57005, it must be 0"
    assert bytes.fromhex(malformed[0]["bytes"]).startswith(garbage)


# -- a device that takes one connection at a time --------------------------------------------------------------------------


class Single(Echo):
    """Refuses a second connection."""

    held: Single | None = None
    count = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if Single.held is not None:
            self.transport.abort()
            return
        Single.held = self
        Single.count += 1

    def connection_lost(self, exc: Exception | None) -> None:
        if Single.held is self:
            Single.held = None


@asynccontextmanager
async def single(kind: type[Echo] = Single) -> AsyncIterator[tuple[int, StreamTap]]:
    Single.held, Single.count = None, 0
    server = await asyncio.get_running_loop().create_server(kind, "127.0.0.1", 0)
    port: int = server.sockets[0].getsockname()[1]
    tap = StreamTap("127.0.0.1", port, framing=protocols()["modbus"].framing, gate=lambda frame: True)
    await tap.start()
    try:
        yield port, tap
    finally:
        await tap.aclose()
        assert tap.open_connections == 0
        server.close()


async def look(port: int) -> None:
    """Ask the device itself, and leave when it has ended its side too."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(OTHER)
    assert await soon(reader.readexactly(12)) == OTHER
    writer.write_eof()
    assert await soon(reader.read()) == b""
    writer.close()


async def test_a_client_of_the_tap_notices_nothing_of_another_one_at_the_device() -> None:
    async with single() as (port, tap), client(tap) as (reader, writer):
        for number in range(1, 6):
            writer.write(READ)
            assert await soon(reader.readexactly(12)) == READ
            assert Single.count == 2 * number - 1
            async with tap.aside():
                # What comes meanwhile waits, and so does another client.
                writer.write(READ)
                async with client(tap) as (_, late):
                    late.write(READ)
                    await look(port)
                    late.transport.abort()
                await soon(tap.journal.wait(0, {"kind": "DISCONNECTED"}, number, 60))
            assert await soon(reader.readexactly(12)) == READ


async def test_a_client_that_ends_meanwhile_is_not_connected_again() -> None:
    async with single() as (port, tap), client(tap) as (reader, writer):
        writer.write(READ)
        await soon(reader.readexactly(12))
        async with tap.aside():
            writer.close()
            await look(port)
            await soon(tap.journal.wait(0, {"kind": "DISCONNECTED"}, 1, 60))
        async with client(tap) as (later, asking):
            asking.write(READ)
            assert await soon(later.readexactly(12)) == READ
        assert Single.count == 3


class Staying(Echo):
    """Keeps its side open when the other one has ended."""

    kept: asyncio.Transport

    def eof_received(self) -> bool:
        Staying.kept = self.transport
        return True


async def test_a_device_that_does_not_end_its_side_is_left_by_a_reset() -> None:
    async with single(Staying) as (_, tap), client(tap) as (reader, writer):
        writer.write(READ)
        await soon(reader.readexactly(12))
        async with tap.aside():
            (link,) = tap._links
            assert link.device.transport is None
            Staying.kept.abort()
        writer.write(READ)
        assert await soon(reader.readexactly(12)) == READ
