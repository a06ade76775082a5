"""MCP over standard input and output, on the event loop's own pipes.

The SDK's ``stdio_server`` reads and writes through worker threads, three hops a message and most of a null call's time
(measured: 0.33 of 0.75 ms). Pipes that the loop watches need none.

The wire belongs to MCP alone: while serving, file descriptor 1 is standard error, so that a stray ``print`` of any
library cannot end up between two messages.
"""

from __future__ import annotations

import asyncio
import os
import sys
from typing import Self

import anyio
from anyio.streams.memory import MemoryObjectSendStream
from mcp.server import Server
from mcp.shared.message import SessionMessage
from mcp.types import jsonrpc_message_adapter
from pydantic import ValidationError

__all__ = ["serve_stdio"]

_MAX_LINE = 32 * 1024 * 1024


class _Input(asyncio.Protocol):
    """Cuts standard input into lines and lines into messages."""

    def __init__(self, messages: MemoryObjectSendStream[SessionMessage | Exception]) -> None:
        self._messages = messages
        self._partial = b""

    def data_received(self, data: bytes) -> None:
        *lines, self._partial = (self._partial + data).split(b"\n")
        for line in lines:
            if line.strip():
                self._deliver(line)
        if len(self._partial) > _MAX_LINE:
            self._messages.close()

    def _deliver(self, line: bytes) -> None:
        try:
            message: SessionMessage | Exception = SessionMessage(jsonrpc_message_adapter.validate_json(line))
        except ValidationError as error:
            message = error
        try:
            self._messages.send_nowait(message)
        except (anyio.BrokenResourceError, anyio.ClosedResourceError):
            self._partial = b""

    def eof_received(self) -> None:
        self._messages.close()

    def connection_lost(self, exc: Exception | None) -> None:
        self._messages.close()


class _Output(asyncio.BaseProtocol):
    """Writes messages straight to the pipe; the write end of the session."""

    def __init__(self) -> None:
        self._writable = asyncio.Event()
        self._writable.set()
        self._pipe: asyncio.WriteTransport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.WriteTransport)
        self._pipe = transport

    def pause_writing(self) -> None:
        self._writable.clear()

    def resume_writing(self) -> None:
        self._writable.set()

    def connection_lost(self, exc: Exception | None) -> None:
        self._writable.set()

    async def send(self, item: SessionMessage, /) -> None:
        if self._pipe.is_closing():
            raise anyio.BrokenResourceError
        self._pipe.write(item.message.model_dump_json(by_alias=True, exclude_unset=True).encode() + b"\n")
        await self._writable.wait()

    async def aclose(self) -> None:
        self._pipe.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.aclose()


async def serve_stdio(server: Server[None]) -> None:
    """Serve until standard input ends."""
    loop = asyncio.get_running_loop()
    wire_in, wire_out = os.dup(0), os.dup(1)
    sys.stdout.flush()
    os.dup2(2, 1)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    send, receive = anyio.create_memory_object_stream[SessionMessage | Exception](float("inf"))
    await loop.connect_read_pipe(lambda: _Input(send), os.fdopen(wire_in, "rb", buffering=0))
    _, output = await loop.connect_write_pipe(_Output, os.fdopen(wire_out, "wb", buffering=0))
    await server.run(receive, output, server.create_initialization_options())
