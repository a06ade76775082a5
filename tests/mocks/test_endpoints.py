"""A device with endpoints of every kind, from a package outside the product, through the real launcher."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest
import pytest_asyncio
from mock_program import PATIENCE_S, MockProgram

from pytest_otmcp.session.free_port import free_port

pytestmark = pytest.mark.asyncio

ENDPOINTS = ("stream", "datagram", "line")


@pytest_asyncio.fixture
async def latches(start_mock: Callable[..., Awaitable[MockProgram]]) -> MockProgram:
    return await start_mock("thirdparty.latches")


class Sender:
    """A client of one endpoint, which sends telegrams of one byte and receives answers of one byte."""

    def __init__(self, address: dict[str, Any]) -> None:
        self.kind = address["kind"]
        if self.kind == "pty":
            self.fd = os.open(address["path"], os.O_RDWR | os.O_NOCTTY)
        else:
            kinds = {"tcp": socket.SOCK_STREAM, "udp": socket.SOCK_DGRAM}
            self._socket = socket.socket(socket.AF_INET, kinds[self.kind])
            self._socket.connect((address["host"], address["port"]))
            self.fd = self._socket.fileno()
        os.set_blocking(self.fd, False)

    def send(self, *telegrams: int) -> None:
        for telegram in telegrams:
            os.write(self.fd, bytes([telegram]))

    async def answer(self) -> int:
        loop, readable = asyncio.get_running_loop(), asyncio.Event()
        loop.add_reader(self.fd, readable.set)
        try:
            await asyncio.wait_for(readable.wait(), PATIENCE_S)
        finally:
            loop.remove_reader(self.fd)
        return os.read(self.fd, 1)[0]

    def nothing_to_read(self) -> bool:
        try:
            os.read(self.fd, 1)
        except BlockingIOError:
            return True
        return False

    def close(self) -> None:
        if self.kind == "pty":
            os.close(self.fd)
        else:
            self._socket.close()


@contextlib.contextmanager
def senders(program: MockProgram, *names: str) -> Iterator[list[Sender]]:
    with contextlib.ExitStack() as opened:
        clients = [Sender(program.ready_event["endpoints"][name]) for name in names]
        for client in clients:
            opened.callback(client.close)
        yield clients


async def stop(program: MockProgram) -> None:
    program.say("stop")
    assert (await program.event())["event"] == "stopped"


async def start(program: MockProgram) -> None:
    program.say("start")
    await program.ready()


async def test_the_ready_line_lists_every_endpoint_and_repeats_the_first(latches: MockProgram) -> None:
    endpoints = latches.ready_event["endpoints"]
    assert {name: address["kind"] for name, address in endpoints.items()} == {
        "stream": "tcp",
        "datagram": "udp",
        "line": "pty",
    }
    assert (latches.host, latches.port) == (endpoints["stream"]["host"], endpoints["stream"]["port"])
    assert latches.ready_event["protocol"] == "thirdparty.latches"


async def test_every_endpoint_is_served_when_the_device_says_so(latches: MockProgram) -> None:
    with senders(latches, *ENDPOINTS) as clients:
        for client in clients:
            client.send(7)
            assert await client.answer() == 8
    assert (await latches.control.image())["points"] == {"clock": 0, **dict.fromkeys(ENDPOINTS, 7)}


async def test_a_restart_keeps_all_addresses_and_the_lines_that_are_open(latches: MockProgram) -> None:
    before = latches.ready_event["endpoints"]
    with senders(latches, "datagram", "line") as clients:
        for value in (1, 2, 3):
            await latches.restart()
            assert latches.ready_event["endpoints"] == before
            for client in clients:
                client.send(value)
                assert await client.answer() == value + 1


@pytest.mark.parametrize("telegrams", [1, 300])
async def test_what_was_sent_during_an_outage_is_never_executed(latches: MockProgram, telegrams: int) -> None:
    with senders(latches, "datagram", "line") as clients:
        for _ in range(5):
            await stop(latches)
            for client in clients:
                client.send(*[66] * telegrams)
            await start(latches)
            for client in clients:
                client.send(5)
                # The first answer is the answer to the first telegram after the start.
                assert await client.answer() == 6
                assert client.nothing_to_read()
            sent = await latches.control.journal(kind="SET")
            assert [(entry["endpoint"], entry["value"]) for entry in sent] == [("datagram", 5), ("line", 5)]


async def test_an_outage_refuses_a_stream_and_is_silent_on_the_others(latches: MockProgram) -> None:
    with senders(latches, "datagram", "line") as clients:
        await stop(latches)
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection(latches.host, latches.port)
        for client in clients:
            # A closed UDP port would make the second send fail: the client would have got "port unreachable" by then.
            client.send(1)
            client.send(2)
            assert client.nothing_to_read()


async def test_answers_of_a_device_that_is_gone_do_not_wait_for_the_next_client_of_the_line(
    latches: MockProgram,
) -> None:
    with senders(latches, "line") as [client]:
        client.send(1, 2, 3)
        await latches.control.wait(kind="DONE", count=3)
        await latches.restart()
        client.send(9)
        assert await client.answer() == 10


async def test_the_ports_of_a_stopped_device_are_given_to_nobody(latches: MockProgram) -> None:
    await stop(latches)
    address = latches.ready_event["endpoints"]["datagram"]
    for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.setsockopt(socket.SOL_SOCKET, option, 1)
            with pytest.raises(OSError, match="in use"):
                other.bind((address["host"], address["port"]))


async def test_the_first_endpoint_gets_the_port_that_is_asked_for(
    start_mock: Callable[..., Awaitable[MockProgram]],
) -> None:
    port = free_port(socket.socket)
    program = await start_mock("thirdparty.latches", "--port", str(port))
    assert program.ready_event["endpoints"]["stream"]["port"] == port


async def test_a_device_may_have_no_port_at_all(start_mock: Callable[..., Awaitable[MockProgram]]) -> None:
    program = await start_mock("thirdparty.terminal")
    assert (program.ready_event["host"], program.ready_event["port"]) == (None, None)
    with senders(program, "line") as [client]:
        client.send(1)
        assert await client.answer() == 2
