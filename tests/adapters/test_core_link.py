"""The link of the core, over loopback connections to a device that answers, ends connections and keeps silent as it is told."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.core import AdapterError, BadReply, Call, DeviceLink

Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class Device:
    """A device that treats each request as the next word says: ``answer``, ``end`` or ``silence``."""

    def __init__(self, *words: str) -> None:
        self.words = list(words)
        self.requests: list[bytes] = []
        self.served: list[asyncio.Task[Any]] = []

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self.served.append(task)
        with contextlib.suppress(ConnectionError):
            while request := await reader.readline():
                self.requests.append(request)
                word = self.words.pop(0)
                if word == "end":
                    break
                if word == "answer":
                    writer.write(request)
        with contextlib.suppress(ConnectionError):
            writer.close()
            await writer.wait_closed()


class Link(DeviceLink[Streams]):
    async def exchange(self, call: Call, request: bytes, *, changes_state: bool = True) -> bytes:
        async def once(streams: Streams) -> bytes:
            call.sending(changes_state=changes_state)
            streams[1].write(request)
            async with asyncio.timeout(self._timeout_s):
                return await streams[0].readuntil(b"\n")

        return await self.perform(call, once)

    failures = (EOFError,)

    async def _open(self) -> Streams:
        return await asyncio.open_connection(self._host, self._port)

    def _is_usable(self, connection: Streams) -> bool:
        return not connection[0].at_eof() and not connection[1].is_closing()

    def _end(self, connection: Streams) -> None:
        connection[1].transport.abort()


def call_of(*, writes: bool) -> Call:
    return Call(protocol="x", operation="x", endpoint="x", writes=writes)


def run(device: Device, work: Callable[[Link], Awaitable[Any]], timeout_s: float = 30.0) -> Any:
    async def main() -> Any:
        async with await asyncio.start_server(device.serve, "127.0.0.1") as server:
            link = Link("127.0.0.1", server.sockets[0].getsockname()[1], timeout_s)
            try:
                return await work(link)
            finally:
                await link.close()
                await asyncio.gather(*device.served)

    return asyncio.run(main())


def failure(device: Device, work: Callable[[Link], Awaitable[Any]]) -> AdapterError:
    with pytest.raises(AdapterError) as raised:
        run(device, work)
    return raised.value


def test_a_read_whose_connection_was_lost_is_repeated_once_over_a_new_one() -> None:
    device, call = Device("end", "answer"), call_of(writes=False)
    assert run(device, lambda link: link.exchange(call, b"r\n")) == b"r\n"
    assert (device.requests, call.attempts) == ([b"r\n"] * 2, 2)
    device = Device("end", "end")
    assert failure(device, lambda link: link.exchange(call_of(writes=False), b"r\n")).code == "connection_lost"
    assert device.requests == [b"r\n"] * 2


def test_a_write_that_may_have_left_is_not_sent_again() -> None:
    device, call = Device("end", "answer"), call_of(writes=True)
    error = failure(device, lambda link: link.exchange(call, b"w\n"))
    assert (error.code, device.requests) == ("connection_lost", [b"w\n"])
    assert call.failure(error)["error"]["outcome"] == "unknown"


def test_a_question_of_a_writing_tool_is_repeated_before_the_write_and_after_it() -> None:
    device, call = Device("end", "answer", "answer", "end", "answer"), call_of(writes=True)

    async def asked_written_asked(link: Link) -> None:
        await link.exchange(call, b"q\n", changes_state=False)
        await link.exchange(call, b"w\n")
        await link.exchange(call, b"q\n", changes_state=False)

    run(device, asked_written_asked)
    assert device.requests == [b"q\n", b"q\n", b"w\n", b"q\n", b"q\n"]


def test_silence_is_a_timeout_that_ends_the_connection_and_is_not_repeated() -> None:
    device = Device("silence", "answer")

    async def twice(link: Link) -> str:
        with pytest.raises(AdapterError, match="did not answer within") as raised:
            await link.exchange(call_of(writes=False), b"1\n")
        call, link._timeout_s = call_of(writes=False), 30.0
        assert await link.exchange(call, b"2\n") == b"2\n"
        assert call.success({})["meta"]["connection"] == {"state": "reconnected", "generation": 2}
        return raised.value.code

    assert run(device, twice, timeout_s=0.3) == "timeout"
    assert device.requests == [b"1\n", b"2\n"]


def test_a_cancelled_exchange_ends_its_connection() -> None:
    device = Device("silence", "answer")

    async def cancelled(link: Link) -> bytes:
        asked = asyncio.create_task(link.exchange(call_of(writes=False), b"1\n"))
        while not device.requests:  # noqa: ASYNC110
            await asyncio.sleep(0)
        asked.cancel()
        with pytest.raises(asyncio.CancelledError):
            await asked
        return await link.exchange(call_of(writes=False), b"2\n")

    assert run(device, cancelled) == b"2\n"


@pytest.mark.parametrize(
    ("raised", "expected", "connections"),
    [
        (AdapterError("illegal_address", "there is no such place"), "there is no such place", 1),
        (BadReply("it is another's"), "the answer is not the one to the request: it is another's", 2),
        (KeyError("a bug"), "a bug", 2),
    ],
)
def test_a_refusal_keeps_the_connection_and_any_other_failure_ends_it(
    raised: Exception, expected: str, connections: int
) -> None:
    async def fail(streams: Streams) -> bytes:
        raise raised

    async def failed_and_asked(link: Link) -> None:
        with pytest.raises((AdapterError, KeyError), match=expected):
            await link.perform(call_of(writes=False), fail)
        await link.exchange(call_of(writes=False), b"r\n")
        assert link._generation == connections

    run(Device("answer"), failed_and_asked)


def test_a_device_that_is_not_there_is_a_connection_that_could_not_be_made() -> None:
    async def nowhere() -> AdapterError:
        async with await asyncio.start_server(Device().serve, "127.0.0.1") as server:
            port = server.sockets[0].getsockname()[1]
        call = call_of(writes=True)
        with pytest.raises(AdapterError, match=f"no connection to 127.0.0.1:{port}; is the device on") as raised:
            await Link("127.0.0.1", port, 1.0).exchange(call, b"w\n")
        assert call.failure(raised.value)["error"]["outcome"] == "not_sent"
        return raised.value

    assert asyncio.run(nowhere()).code == "connect_failed"
