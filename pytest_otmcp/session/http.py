"""Transport of MCP over streamable HTTP to a subprocess; records every frame (MCP basic/transports, Streamable HTTP).

The SDK's own client transport carries the messages. A recorder sits below it, where requests and responses are bytes.
"""

from __future__ import annotations

import asyncio
import json
import socket
import time
from collections.abc import AsyncIterator, Iterable, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import httpcore2
import httpx2
from anyio.abc import SocketStream
from httpcore2._backends.anyio import AnyIOStream
from mcp.client.streamable_http import streamable_http_client

from ..core.exhaustion import exhausted
from .caller import Caller
from .canary import STDERR, STDOUT
from .exchange import REFUSALS
from .frames import FrameRecorder
from .limits import MAX_FRAME_BYTES, TOO_LARGE
from .process import StopReport, SubjectProcess

if TYPE_CHECKING:
    from mcp.client._transport import TransportStreams

    from .isolation import Walls

__all__ = ["HttpTransport"]

_POLL_S = 0.02
"""Interval at which the kit tries to connect to a starting server, which has no way to say that it is ready."""

_ATTEMPTS = 32
"""Attempts to read a body of unknown length before its end; a server may send it byte by byte."""

# The session keeps the deadline of each call; these limits only end the wait for a dead connection.
_FIRST_ERROR = 400
"""First HTTP status of an error."""
_TIMEOUT = httpx2.Timeout(30.0, read=330.0)
_KEPT_S = 1.0
"""Seconds for which an idle connection is used again. Servers close one after 5 (uvicorn, Node), the library's own value as well: a call that
was sent in that very moment was lost, and the adapter was blamed for it."""


class HttpTransport:
    """Process of the subject and carrier of messages to and from its URL, for one session."""

    def __init__(
        self,
        command: Sequence[str],
        env: Mapping[str, str],
        cwd: Path | None,
        url: str,
        recorder: FrameRecorder,
        exit_grace_s: float,
        *,
        walls: Walls | None = None,
        caller: Caller | None = None,
    ) -> None:
        self.process: SubjectProcess | None = None
        self.stop_report: StopReport | None = None
        self._command = command
        self._env = env
        self._cwd = cwd
        self._url = url
        self._recorder = recorder
        self._exit_grace_s = exit_grace_s
        self._walls = walls
        self._caller = caller

    @property
    def died(self) -> bool:
        """True when the process has ended, or was never started."""
        return self.process is None or self.process.exited.is_set()

    def write_line(self, line: bytes) -> bool:
        """Return False: messages go by HTTP requests, and standard input carries none."""
        return False

    async def stop(self) -> StopReport | None:
        """End the process if it still runs; a server on the network is asked by SIGTERM."""
        if self.process is not None and self.stop_report is None:
            self.stop_report = await self.process.stop(grace_s=self._exit_grace_s, reads_stdin=False)
        return self.stop_report

    @asynccontextmanager
    async def streams(self) -> AsyncIterator[TransportStreams]:
        """Start the process and give the streams for the SDK's client; the end of the block ends the process."""
        secrets = self._recorder.secrets
        self.process = await SubjectProcess.start(
            self._command,
            env=self._env,
            cwd=self._cwd,
            # A server on the network may print anything: its stdout carries no MCP messages.
            on_line=lambda now, line: secrets.look(line, lambda: STDOUT),
            on_overflow=lambda now: None,
            on_stderr=secrets.stream(STDERR),
            walls=self._walls,
        )
        try:
            await self._wait_until_accepting(self.process)
            recording = _RecordingTransport(self._recorder, self._walls, self._caller)
            async with (
                httpx2.AsyncClient(transport=recording, timeout=_TIMEOUT) as client,
                streamable_http_client(self._url, http_client=client) as streams,
            ):
                yield streams
        finally:
            await asyncio.shield(self.stop())

    async def _wait_until_accepting(self, process: SubjectProcess) -> None:
        parts = urlsplit(self._url)
        while not process.exited.is_set():
            try:
                connection = await connected(self._walls, parts.hostname or "", parts.port or 80)
            except OSError as error:
                if exhausted(error) is not None:
                    raise
                await asyncio.sleep(_POLL_S)
                continue
            connection.close()
            return
        raise ConnectionError(f"the process ended before {self._url} accepted a connection")


async def connected(walls: Walls | None, host: str, port: int) -> socket.socket:
    """Return a TCP connection to an adapter, in the network in which it is.

    Raises:
        OSError: there is none.
    """
    loop = asyncio.get_running_loop()
    failure: OSError | None = None
    for family, kind, _, _, address in await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM):
        made = socket.socket(family, kind) if walls is None else walls.socket(kind, family)
        try:
            made.setblocking(False)
            made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            await loop.sock_connect(made, address)
        except OSError as error:
            made.close()
            failure = error
        except BaseException:
            made.close()
            raise
        else:
            return made
    raise failure or OSError(f"{host} has no address")


class _Backend(httpcore2.AnyIOBackend):
    """The network in which an adapter is, for the HTTP library."""

    def __init__(self, walls: Walls | None) -> None:
        self._walls = walls

    async def connect_tcp(
        self,
        host: str,
        port: int,
        timeout: float | None = None,
        local_address: str | None = None,
        socket_options: Iterable[Any] | None = None,
    ) -> httpcore2.AsyncNetworkStream:
        try:
            async with asyncio.timeout(timeout):
                stream = await SocketStream.from_socket(await connected(self._walls, host, port))
        except TimeoutError as error:
            raise httpcore2.ConnectTimeout(str(error)) from error
        except OSError as error:
            raise httpcore2.ConnectError(str(error)) from error
        return AnyIOStream(stream)


class _RecordingTransport(httpx2.AsyncBaseTransport):
    """HTTP transport that hands every JSON-RPC message to the recorder."""

    def __init__(self, recorder: FrameRecorder, walls: Walls | None, caller: Caller | None) -> None:
        # Both processes are on this machine, so proxies of the environment do not apply.
        # With the library's limit of 100 connections further calls would wait in the kit, and the adapter be blamed for it.
        limits = httpx2.Limits(max_connections=None, keepalive_expiry=_KEPT_S)
        self._network = httpx2.AsyncHTTPTransport(trust_env=False, limits=limits)
        # The library has a place for a network of one's own in what it is made of, and none in its own interface.
        self._network._pool._network_backend = _Backend(walls)
        self._recorder = recorder
        self._caller = caller

    async def handle_async_request(self, request: httpx2.Request) -> httpx2.Response:
        body = await request.aread()
        asked = None
        if request.method == "POST" and body:
            message = json.loads(body)
            if "id" in message and "method" in message:
                asked = message["id"]
                self._recorder.sent(time.monotonic_ns(), body, asked, message.get("params"))
        # What is compressed could neither be recorded as it is read nor be limited: a few kilobytes may become gigabytes.
        request.headers["accept-encoding"] = "identity"
        if self._caller is not None:
            request.headers.update(self._caller.headers())
        response = await self._network.handle_async_request(request)
        refusal = REFUSALS.get(response.status_code)
        if refusal is not None:
            self._recorder.refused(time.monotonic_ns(), asked, refusal)
        response.headers.pop("content-encoding", None)
        for name, value in response.headers.raw:
            self._recorder.secrets.look(value, lambda name=name: f"the header {name.decode('latin-1')} of an answer")  # type: ignore[misc]
        # As the client takes them: what it reads is recorded, and limited.
        kind = response.headers.get("content-type", "").lower()
        assert isinstance(response.stream, httpx2.AsyncByteStream)
        if refusal is not None:
            response.stream = _Unread(response.stream)
        elif kind.startswith(("application/json", "text/event-stream")):
            length = response.headers.get("content-length", "")
            response.stream = _RecordedBody(
                response.stream,
                self._recorder,
                events=kind.startswith("text/event-stream"),
                length=int(length) if length.isdecimal() else None,
                of_error=response.status_code >= _FIRST_ERROR,
            )
        return response

    async def aclose(self) -> None:
        await self._network.aclose()


class _Unread(httpx2.AsyncByteStream):
    """Body of a refusal, which is no message of MCP: what matters is the status."""

    def __init__(self, stream: httpx2.AsyncByteStream) -> None:
        self._stream = stream

    async def __aiter__(self) -> AsyncIterator[bytes]:
        return
        yield b""

    async def aclose(self) -> None:
        await self._stream.aclose()


class _RecordedBody(httpx2.AsyncByteStream):
    """Response body that is recorded while it is read: one JSON message, or server-sent events with one message each.

    Args:
        stream: the body.
        recorder: of the session.
        events: the body consists of events.
        length: of the body in bytes, where the server has said it.
        of_error: the status of the answer is that of an error.
    """

    def __init__(
        self,
        stream: httpx2.AsyncByteStream,
        recorder: FrameRecorder,
        *,
        events: bool,
        length: int | None,
        of_error: bool,
    ) -> None:
        self._stream = stream
        self._recorder = recorder
        self._events = events
        self._length = length
        self._of_error = of_error
        self._attempts = 0
        self._unread = bytearray()
        self._data: list[bytes] = []
        self._data_bytes = 0

    async def __aiter__(self) -> AsyncIterator[bytes]:
        async for chunk in self._stream:
            # The chunk is recorded before the client sees it: a call must find its response recorded when it returns.
            self._record(chunk)
            yield chunk
        if not self._events and self._unread:
            self._receive(time.monotonic_ns(), bytes(self._unread))

    def _record(self, chunk: bytes) -> None:
        now = time.monotonic_ns()
        self._unread += chunk
        if len(self._unread) + self._data_bytes > MAX_FRAME_BYTES:
            self._recorder.overflow = True
            raise httpx2.ReadError(f"the adapter sent {TOO_LARGE}")
        if not self._events:
            if len(self._unread) == self._length or self._is_whole(chunk):
                self._receive(now, bytes(self._unread))
                self._unread.clear()
            return
        if b"\n" not in chunk:
            return
        *lines, rest = bytes(self._unread).split(b"\n")
        self._unread = bytearray(rest)
        for line in map(bytes.strip, lines):
            if line.startswith(b"data:"):
                self._data.append(line[5:].removeprefix(b" "))
                self._data_bytes += len(line)
            elif not line and self._data:
                frame, self._data, self._data_bytes = b"\n".join(self._data), [], 0
                if frame:
                    self._receive(now, frame)

    def _is_whole(self, chunk: bytes) -> bool:
        """Tell whether a body of unknown length is complete: its end is signalled after its last byte, but the reply is
        complete, and timed, with that byte."""
        if self._length is not None or not chunk.rstrip().endswith(b"}") or self._attempts == _ATTEMPTS:
            return False
        self._attempts += 1
        frame = bytes(self._unread)
        try:
            return self._recorder.accepts(frame) and json.loads(frame) is not None
        except (ValueError, RecursionError):
            return False

    def _receive(self, now: int, frame: bytes) -> None:
        if self._recorder.accepts(frame):
            self._recorder.received(now, frame, of_error=self._of_error)
        if self._recorder.overflow:
            raise httpx2.ReadError(f"the adapter sent {TOO_LARGE}")

    async def aclose(self) -> None:
        await self._stream.aclose()
