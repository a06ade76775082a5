"""MCP over standard input and output, on the event loop's own pipes.

The SDK's ``stdio_server`` reads and writes through worker threads: three hops per message, and most of a null call's
time (measured: 0.33 of 0.75 ms). The loop watches the pipes here, without threads.

Only MCP messages reach the output pipe: while serving, file descriptor 1 is standard error, so that a stray ``print`` of a
library cannot end up between two messages.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import re
import signal
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Self

import anyio
from anyio.streams.memory import MemoryObjectSendStream
from mcp.server import Server
from mcp.server.stdio import stdio_server
from mcp.shared.message import SessionMessage
from mcp.types import INVALID_REQUEST, ErrorData, JSONRPCError, JSONRPCMessage, jsonrpc_message_adapter
from pydantic import ValidationError

__all__ = ["serve_stdio"]

_MAX_LINE = 32 * 1024 * 1024
_FLUSH_S = 0.2
_EDGE = 4096
"""Bytes of the beginning and of the end of a line that is too long, in which its id is looked for."""

_PLAIN = rb'"(?:jsonrpc|method)"\s*:\s*"[^"\\]*"'
_ID = rb'"id"\s*:\s*(-?\d{1,18}|"[^"\\\x00-\x1f\x80-\xff]*")'
# The id of the message itself, not one in its parameters: only plain members are between it and the outermost brace.
_ID_FIRST = re.compile(rb"\s*\{\s*(?:" + _PLAIN + rb"\s*,\s*)*" + _ID)
_ID_LAST = re.compile(rb",\s*" + _ID + rb"\s*(?:,\s*" + _PLAIN + rb"\s*)*\}\s*$")

log = logging.getLogger(__name__)


class _Input(asyncio.Protocol):
    """Standard input, cut into lines that are parsed as messages. Other lines are dropped, with a warning on stderr.

    Args:
        messages: where messages go.
        refuse: sends the answer to a request that is too long to be read.
    """

    def __init__(
        self, messages: MemoryObjectSendStream[SessionMessage | Exception], refuse: Callable[[JSONRPCError], None]
    ) -> None:
        self._messages = messages
        self._refuse = refuse
        self._buffer = bytearray()
        self._searched = 0
        self._head: bytes | None = None
        """The beginning of a line that is too long, of which ``_buffer`` holds the end."""

    def data_received(self, data: bytes) -> None:
        self._buffer += data
        start = 0
        while (end := self._buffer.find(b"\n", max(start, self._searched))) >= 0:
            line = bytes(self._buffer[start:end])
            start = end + 1
            if self._head is not None:
                self._drop(self._head, line)
                self._head = None
            elif not line.isspace() and line:
                self._deliver(line)
        if start:
            del self._buffer[:start]
        if len(self._buffer) > _MAX_LINE:
            if self._head is None:
                self._head = bytes(self._buffer[:_EDGE])
            del self._buffer[:-_EDGE]
        self._searched = len(self._buffer)

    def _drop(self, head: bytes, tail: bytes) -> None:
        """Answer a line that is too long, if it is a request: who waits for an answer gets one."""
        log.warning("a line of more than %d bytes was dropped", _MAX_LINE)
        found = _ID_FIRST.match(head) or _ID_LAST.search(tail[-_EDGE:])
        if found is not None:
            text = f"the request is longer than {_MAX_LINE} bytes"
            self._refuse(
                JSONRPCError(
                    jsonrpc="2.0", id=json.loads(found[1]), error=ErrorData(code=INVALID_REQUEST, message=text)
                )
            )

    def _deliver(self, line: bytes) -> None:
        try:
            message = jsonrpc_message_adapter.validate_json(line, by_name=False)
        except ValidationError:
            try:
                message = _second_reading(line)
            except (ValueError, RecursionError):
                log.warning("a line of %d bytes that is no JSON-RPC message was dropped", len(line))
                return
        # The stream is closed when the session has ended; a later message is not answered.
        with suppress(anyio.BrokenResourceError, anyio.ClosedResourceError):
            self._messages.send_nowait(SessionMessage(message))

    def eof_received(self) -> None:
        self._messages.close()

    def connection_lost(self, exc: Exception | None) -> None:
        self._messages.close()


def _second_reading(line: bytes) -> JSONRPCMessage:
    """Parse a line less strictly: deep nesting and lone surrogates reach the tool, which refuses them with a reason.

    Raises:
        ValueError, RecursionError: the line is no message.
    """
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(10 * limit)
    try:
        return jsonrpc_message_adapter.validate_python(json.loads(line), by_name=False)
    finally:
        sys.setrecursionlimit(limit)


class _Output(asyncio.BaseProtocol):
    """The write end of the session, which writes messages directly to the pipe."""

    def __init__(self) -> None:
        self._writable = asyncio.Event()
        self._writable.set()
        self._lost = asyncio.Event()
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
        self._lost.set()

    async def flushed(self) -> None:
        """Wait for a short time only until the sent messages have left: the client may have stopped reading."""
        with suppress(TimeoutError):
            async with asyncio.timeout(_FLUSH_S):
                await self._lost.wait()

    def write(self, message: JSONRPCMessage) -> None:
        self._pipe.write(message.model_dump_json(by_alias=True, exclude_unset=True).encode() + b"\n")

    async def send(self, item: SessionMessage, /) -> None:
        if self._pipe.is_closing():
            raise anyio.BrokenResourceError
        self.write(item.message)
        await self._writable.wait()

    async def aclose(self) -> None:
        self._pipe.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.aclose()


async def serve_stdio(server: Server[None]) -> None:
    """Serve until standard input ends, or a signal ends the process."""
    if not (_is_pipe(0) and _is_pipe(1)):
        # In ``adapter < requests.jsonl`` the input is a file: the loop cannot watch it; the SDK's threads can read it.
        async with stdio_server() as (read, write):
            await server.run(read, write, server.create_initialization_options())
        return
    loop = asyncio.get_running_loop()
    wire_in, wire_out = os.dup(0), os.dup(1)
    sys.stdout.flush()
    os.dup2(2, 1)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    send, receive = anyio.create_memory_object_stream[SessionMessage | Exception](float("inf"))
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, send.close)
    _, output = await loop.connect_write_pipe(_Output, os.fdopen(wire_out, "wb", buffering=0))
    await loop.connect_read_pipe(lambda: _Input(send, output.write), os.fdopen(wire_in, "rb", buffering=0))
    await server.run(receive, output, server.create_initialization_options())
    await output.flushed()


def _is_pipe(descriptor: int) -> bool:
    mode = os.fstat(descriptor).st_mode
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) or os.isatty(descriptor)
