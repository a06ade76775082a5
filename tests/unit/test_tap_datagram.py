"""The relay of datagrams against a real UDP device: what passes, what is recorded, outages, and each fault it can inject."""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

import pytest

from pytest_otmcp.errors import KitError
from pytest_otmcp.plant.endpoint import Endpoint
from pytest_otmcp.plant.tap import datagram
from pytest_otmcp.plant.tap.datagram import DatagramTap
from pytest_otmcp.plant.tap.faults import Action, FaultRule
from pytest_otmcp.plant.tap.stream import StreamTap
from pytest_otmcp.plant.tap.tap import new_tap
from pytest_otmcp.plant.tapped_device import TappedDevice
from pytest_otmcp.protocols.conversation import Direction, Message, Outstanding
from pytest_otmcp.protocols.protocol import Framing

pytestmark = pytest.mark.asyncio


class Telegrams:
    """A protocol of datagrams with an identifier and a value: the device answers with the same identifier."""

    def __init__(self) -> None:
        self._outstanding = Outstanding()

    def decode(self, direction: Direction, frame: bytes) -> list[Message]:
        if len(frame) != 2:
            return [
                Message(direction=direction, kind="malformed", fields={"bytes": frame.hex(), "reason": "its length"})
            ]
        fields = {"id": frame[0], "value": frame[1]}
        if direction == "out":
            return [Message(direction="out", kind="DONE", fields=fields, answers=self._outstanding.take(frame[0]))]
        message = Message(direction="in", kind="SET", fields=fields, request=True, state_changing=frame[1] > 0)
        self._outstanding.add(frame[0], message)
        return [message]


FRAMING = Framing(conversation=Telegrams)


class Echo(asyncio.DatagramProtocol):
    """A device that sends back what it gets.

    Attributes:
        received: all datagrams and where they came from.
        answers: whether it answers.
        own: its socket.
    """

    def __init__(self, own: socket.socket) -> None:
        self.received: list[tuple[bytes, Any]] = []
        self.answers = True
        self.own = own

    def datagram_received(self, data: bytes, address: Any) -> None:
        self.received.append((data, address))
        if self.answers:
            # Before Python 3.13 a transport sends no empty datagram.
            self.own.sendto(data, address)


async def echo() -> tuple[asyncio.DatagramTransport, Echo]:
    own = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    own.bind(("127.0.0.1", 0))
    return await asyncio.get_running_loop().create_datagram_endpoint(lambda: Echo(own), sock=own)


@asynccontextmanager
async def tapped(framing: Framing | None = FRAMING) -> AsyncIterator[tuple[DatagramTap, Echo]]:
    transport, device = await echo()
    tap = DatagramTap(*transport.get_extra_info("sockname"), framing=framing)
    await tap.start()
    try:
        yield tap, device
    finally:
        await tap.aclose()
        transport.close()
        assert tap.open_connections == 0


class Client:
    """A UDP client; the system tells it when its port is unreachable."""

    def __init__(self, tap: DatagramTap) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect((tap.host, tap.port))

    def send(self, *datagrams: bytes) -> None:
        for data in datagrams:
            self._socket.send(data)

    async def receive(self) -> bytes:
        """Wait for a datagram that must come; the limit only keeps a broken relay from hanging the tests."""
        return await asyncio.wait_for(asyncio.get_running_loop().sock_recv(self._socket, 65_535), 60)

    async def ask(self, data: bytes) -> bytes:
        self.send(data)
        return await self.receive()

    def nothing_to_read(self) -> bool:
        with contextlib.suppress(BlockingIOError):
            self._socket.recv(1)
            return False
        return True

    def close(self) -> None:
        self._socket.close()


@contextmanager
def client(tap: DatagramTap) -> Iterator[Client]:
    one = Client(tap)
    try:
        yield one
    finally:
        one.close()


def noted(tap: DatagramTap) -> list[tuple[int, str, Any, Any]]:
    return [(e["connection"], e["kind"], e["answers"], e.get("fault")) for e in tap.journal.since(0)]


async def test_datagrams_of_any_length_pass_whole_in_both_directions() -> None:
    async with tapped(None) as (tap, device):
        with client(tap) as one:
            for data in (b"", b"x", bytes(1400), bytes(range(256)) * 255):
                assert await one.ask(data) == data
        assert [len(data) for data, _ in device.received] == [0, 1, 1400, 65_280]
        assert tap.journal.since(0) == []


async def test_each_client_has_a_connection_of_its_own_and_gets_its_own_answers() -> None:
    async with tapped() as (tap, device):
        with client(tap) as one, client(tap) as other:
            one.send(b"\x01\x07")
            other.send(b"\x01\x08", b"\x02\x00")
            assert await one.receive() == b"\x01\x07"
            assert [await other.receive(), await other.receive()] == [b"\x01\x08", b"\x02\x00"]
            assert await one.ask(b"\x02\x09") == b"\x02\x09"
        entries = tap.journal.since(0)
    assert len({address for _, address in device.received}) == 2
    by_client = {number: [entry for entry in entries if entry["connection"] == number] for number in (1, 2)}
    for mine in by_client.values():
        asked = [entry["seq"] for entry in mine if entry["request"]]
        assert [entry["answers"] for entry in mine if not entry["request"]] == asked
        assert len(asked) == 2
    assert [entry["state_changing"] for entry in by_client[2] if entry["request"]] == [True, False]
    assert {entry["origin"] for entry in entries} == {"client"}


async def test_an_outage_is_silence_and_what_is_sent_meanwhile_is_never_delivered() -> None:
    async with tapped() as (tap, device):
        port = tap.port
        with client(tap) as one, client(tap) as other:
            assert await one.ask(b"\x01\x07") == b"\x01\x07"
            await tap.down()
            # The relay has never seen the other client. If the port was gone, the second send of a client would fail.
            for number in range(200):
                one.send(bytes([number, 1]))
            other.send(b"\x01\x01", b"\x02\x01")
            await tap.up()
            assert tap.port == port
            assert await one.ask(b"\x02\x08") == b"\x02\x08"
            assert await other.ask(b"\x03\x09") == b"\x03\x09"
            assert one.nothing_to_read()
        assert [data for data, _ in device.received] == [b"\x01\x07", b"\x02\x08", b"\x03\x09"]
        assert [entry["connection"] for entry in tap.journal.since(0) if entry["request"]] == [1, 2, 3]


async def test_an_answer_that_comes_after_an_outage_is_not_delivered() -> None:
    async with tapped() as (tap, device):
        with client(tap) as one:
            device.answers = False
            one.send(b"\x01\x07")
            await tap.journal.wait(0, {"kind": "SET"}, 1, 60.0)
            await tap.down()
            await tap.up()
            device.answers = True
            assert await one.ask(b"\x02\x08") == b"\x02\x08"
            data, address = device.received[0]
            device.own.sendto(data, address)
            assert await one.ask(b"\x03\x09") == b"\x03\x09"
        answered: list[Any] = await tap.journal.wait(0, {"kind": "DONE"}, 2, 60.0)
        assert [entry["value"] for entry in answered] == [8, 9]


async def test_a_delayed_datagram_does_not_survive_an_outage() -> None:
    async with tapped() as (tap, device):
        tap.inject(FaultRule(action=Action.DELAY, direction="in", seconds=0.02))
        loop = asyncio.get_running_loop()
        clock, now = loop.time, loop.time()
        with client(tap) as one:
            # The clock stands still: the delay is not over before the outage, however long this process waits for a processor.
            loop.time = lambda: now  # type: ignore[method-assign]
            one.send(b"\x01\x07")
            await tap.journal.wait(0, {"kind": "SET"}, 1, 60.0)
            await tap.down()
            loop.time = clock  # type: ignore[method-assign]
            await tap.up()
            tap.inject(FaultRule(action=Action.DELAY, direction="in", seconds=0.04))
            assert await one.ask(b"\x02\x08") == b"\x02\x08"
        assert [data for data, _ in device.received] == [b"\x02\x08"]


async def test_a_device_that_is_not_there_is_silent() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unused:
        unused.bind(("127.0.0.1", 0))
        address = unused.getsockname()
    tap = DatagramTap(*address, framing=FRAMING)
    await tap.start()
    with client(tap) as one:
        one.send(b"\x01\x07")
        await tap.journal.wait(0, {"kind": "SET"}, 1, 60.0)
        one.send(b"\x02\x08")
        assert len(await tap.journal.wait(0, {"kind": "SET"}, 2, 60.0)) == 2
        assert one.nothing_to_read()
    await tap.aclose()


async def test_of_too_many_clients_the_one_that_was_silent_for_longest_is_forgotten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(datagram, "_MOST_CLIENTS", 3)
    async with tapped() as (tap, _):
        clients = [Client(tap) for _ in range(4)]
        for number in (0, 1, 2, 0, 3):
            assert await clients[number].ask(b"\x01\x01") == b"\x01\x01"
        assert tap.open_connections == 3
        # Only the second client needs a new connection.
        for number in (0, 2, 3, 1):
            assert await clients[number].ask(b"\x02\x01") == b"\x02\x01"
        asked = [entry["connection"] for entry in tap.journal.since(0) if entry["request"]]
        for one in clients:
            one.close()
    assert asked == [1, 2, 3, 1, 4, 1, 3, 4, 5]


# -- faults ---------------------------------------------------------------------------------------------------


async def test_a_dropped_answer_is_missing_and_the_next_one_comes() -> None:
    async with tapped() as (tap, device):
        tap.inject(FaultRule(action=Action.DROP, direction="out"))
        with client(tap) as one:
            one.send(b"\x01\x07")
            assert await one.ask(b"\x02\x08") == b"\x02\x08"
        assert [data for data, _ in device.received] == [b"\x01\x07", b"\x02\x08"]
        assert tap.injected == {Action.DROP: 1}
        assert [entry for entry in noted(tap) if entry[1] == "DONE"] == [(1, "DONE", 0, "drop"), (1, "DONE", 1, None)]


async def test_duplicate_and_reorder_move_whole_datagrams() -> None:
    async with tapped() as (tap, device):
        with client(tap) as one:
            tap.inject(FaultRule(action=Action.DUPLICATE, direction="in"))
            one.send(b"\x01\x07")
            assert [await one.receive(), await one.receive()] == [b"\x01\x07"] * 2
            tap.inject(FaultRule(action=Action.REORDER, direction="in"))
            one.send(b"\x02\x08", b"\x03\x09")
            assert [await one.receive(), await one.receive()] == [b"\x03\x09", b"\x02\x08"]
        assert [data for data, _ in device.received] == [b"\x01\x07", b"\x01\x07", b"\x03\x09", b"\x02\x08"]


async def test_corrupt_and_truncate_change_one_datagram() -> None:
    async with tapped() as (tap, _):
        with client(tap) as one:
            tap.inject(
                FaultRule(action=Action.CORRUPT, direction="out", offset=-1, mask=0x0F),
                FaultRule(action=Action.TRUNCATE, direction="out", frame=2, length=1),
                FaultRule(action=Action.TRUNCATE, direction="out", frame=3, length=0),
            )
            asked = (b"\x01\x07", b"\x02\x08", b"\x03\x09", b"\x04\x0a")
            assert [await one.ask(data) for data in asked] == [b"\x01\x08", b"\x02", b"", b"\x04\x0a"]


async def test_a_delayed_datagram_keeps_its_place_before_later_ones() -> None:
    async with tapped() as (tap, _):
        tap.inject(FaultRule(action=Action.DELAY, direction="in", seconds=0.05))
        began = asyncio.get_running_loop().time()
        with client(tap) as one:
            one.send(b"\x01\x07", b"\x02\x08")
            assert [await one.receive(), await one.receive()] == [b"\x01\x07", b"\x02\x08"]
        # A lower bound is no measurement of performance: the datagram cannot have come earlier.
        assert asyncio.get_running_loop().time() - began >= 0.045


async def test_a_black_hole_swallows_one_client_until_the_plan_ends() -> None:
    async with tapped() as (tap, device):
        with client(tap) as one, client(tap) as other:
            assert await one.ask(b"\x01\x01") == b"\x01\x01"
            tap.inject(FaultRule(action=Action.BLACK_HOLE, direction="in", connection=1))
            one.send(b"\x02\x02", b"\x03\x03")
            assert await other.ask(b"\x01\x04") == b"\x01\x04"
            tap.inject()
            assert await one.ask(b"\x04\x05") == b"\x04\x05"
        assert [data for data, _ in device.received] == [b"\x01\x01", b"\x01\x04", b"\x04\x05"]


@pytest.mark.parametrize("action", [Action.REFUSE, Action.RESET, Action.DRIP])
async def test_faults_of_connections_do_not_exist_among_datagrams(action: Action) -> None:
    tap = DatagramTap("127.0.0.1", 9)
    with pytest.raises(ValueError, match=f"there is no '{action.value}' among datagrams"):
        tap.inject(FaultRule(action=Action.DROP), FaultRule(action=action))
    assert tap.injected == {}


# -- the choice of the tap ------------------------------------------------------------------------------------


async def test_the_kind_of_the_endpoint_chooses_the_tap() -> None:
    cut = Framing(frame_length=len, conversation=Telegrams)
    assert isinstance(new_tap(Endpoint(name="a", kind="tcp", host="127.0.0.1", port=9), cut), StreamTap)
    assert isinstance(new_tap(Endpoint(name="a", kind="udp", host="127.0.0.1", port=9), cut), DatagramTap)
    with pytest.raises(KitError, match="a TCP connection cannot be recorded: the frames of its protocol are datagrams"):
        new_tap(Endpoint(name="a", kind="tcp", host="127.0.0.1", port=9), FRAMING)
    with pytest.raises(KitError, match="the endpoint 'line' is a pseudo terminal"):
        new_tap(Endpoint(name="line", kind="pty", path="/dev/pts/0"), FRAMING)


async def test_a_device_of_the_users_own_may_speak_datagrams() -> None:
    transport, actuator = await echo()
    host, port = transport.get_extra_info("sockname")
    device = TappedDevice("actuator udp://echo", Endpoint(name="actuator", kind="udp", host=host, port=port), FRAMING)
    await device.launch()
    try:
        assert device.endpoints == {
            "actuator": Endpoint(name="actuator", kind="udp", host=device.host, port=device.port)
        }
        assert isinstance(device.tap, DatagramTap)
        with client(device.tap) as one:
            assert await one.ask(b"\x01\x07") == b"\x01\x07"
            assert [entry["kind"] for entry in (await device.journal(0)).entries] == ["SET", "DONE"]
            await device.forget(await device.mark())
            await device.stop()
            one.send(b"\x02\x08")
            await device.start()
            assert await one.ask(b"\x03\x09") == b"\x03\x09"
            assert [entry["seq"] for entry in (await device.journal(0)).entries] == [0, 1]
        assert [data for data, _ in actuator.received] == [b"\x01\x07", b"\x03\x09"]
        with pytest.raises(KitError, match="the actuator udp://echo cannot be asked what it holds"):
            await device.image()
        with pytest.raises(KitError, match="the actuator udp://echo cannot be changed past the tap"):
            await device.poke(value=1)
    finally:
        await device.close()
        transport.close()
