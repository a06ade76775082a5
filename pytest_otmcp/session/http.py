"""Transport of MCP over streamable HTTP to a subprocess; records every frame (MCP basic/transports, Streamable HTTP).

The SDK's own client transport carries the messages. A recorder sits below it, where requests and responses are bytes.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import httpx2
from mcp.client.streamable_http import streamable_http_client

from ..core.exhaustion import exhausted
from .frames import FrameRecorder
from .process import MAX_FRAME_BYTES, StopReport, SubjectProcess

if TYPE_CHECKING:
    from mcp.client._transport import TransportStreams

__all__ = ["HttpTransport"]

_POLL_S = 0.02
"""Interval at which the kit tries to connect to a starting server, which has no way to say that it is ready."""

# The session keeps the deadline of each call; these limits only end the wait for a dead connection.
_TIMEOUT = httpx2.Timeout(30.0, read=330.0)


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
    ) -> None:
        self.process: SubjectProcess | None = None
        self.stop_report: StopReport | None = None
        self._command = command
        self._env = env
        self._cwd = cwd
        self._url = url
        self._recorder = recorder
        self._exit_grace_s = exit_grace_s

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
        self.process = await SubjectProcess.start(
            self._command,
            env=self._env,
            cwd=self._cwd,
            # A server on the network may print anything: its stdout carries no MCP messages.
            on_line=lambda now, line: None,
            on_overflow=lambda now: None,
        )
        try:
            await self._wait_until_accepting(self.process)
            recording = _RecordingTransport(self._recorder)
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
                _, writer = await asyncio.open_connection(parts.hostname, parts.port or 80)
            except OSError as error:
                if exhausted(error) is not None:
                    raise
                await asyncio.sleep(_POLL_S)
                continue
            writer.close()
            return
        raise ConnectionError(f"the process ended before {self._url} accepted a connection")


class _RecordingTransport(httpx2.AsyncBaseTransport):
    """HTTP transport that hands every JSON-RPC message to the recorder."""

    def __init__(self, recorder: FrameRecorder) -> None:
        # Both processes are on this machine, so proxies of the environment do not apply.
        self._network = httpx2.AsyncHTTPTransport(trust_env=False)
        self._recorder = recorder

    async def handle_async_request(self, request: httpx2.Request) -> httpx2.Response:
        body = await request.aread()
        if request.method == "POST" and body:
            message = json.loads(body)
            if "id" in message and "method" in message:
                self._recorder.sent(time.monotonic_ns(), body, message["id"], message.get("params"))
        response = await self._network.handle_async_request(request)
        kind = response.headers.get("content-type", "").partition(";")[0].strip()
        assert isinstance(response.stream, httpx2.AsyncByteStream)
        if kind in ("application/json", "text/event-stream"):
            response.stream = _RecordedBody(response.stream, self._recorder, events=kind == "text/event-stream")
        return response

    async def aclose(self) -> None:
        await self._network.aclose()


class _RecordedBody(httpx2.AsyncByteStream):
    """Response body that is recorded while it is read: one JSON message, or server-sent events with one message each."""

    def __init__(self, stream: httpx2.AsyncByteStream, recorder: FrameRecorder, *, events: bool) -> None:
        self._stream = stream
        self._recorder = recorder
        self._events = events
        self._unread = b""
        self._data: list[bytes] = []

    async def __aiter__(self) -> AsyncIterator[bytes]:
        async for chunk in self._stream:
            # The chunk is recorded before the client sees it: a call must find its response recorded when it returns.
            self._record(chunk)
            yield chunk
        if not self._events and self._unread:
            self._recorder.received(time.monotonic_ns(), self._unread)

    def _record(self, chunk: bytes) -> None:
        now = time.monotonic_ns()
        self._unread += chunk
        if len(self._unread) > MAX_FRAME_BYTES:
            self._recorder.overflow = True
            raise httpx2.ReadError("the adapter sent a message longer than the kit reads")
        if not self._events:
            self._record_whole_body(now)
            return
        *lines, self._unread = self._unread.split(b"\n")
        for line in map(bytes.strip, lines):
            if line.startswith(b"data:"):
                self._data.append(line[5:].removeprefix(b" "))
            elif not line and self._data:
                frame, self._data = b"\n".join(self._data), []
                if frame:
                    self._recorder.received(now, frame)

    def _record_whole_body(self, now: int) -> None:
        # The end of a body is signalled after its last byte, but the reply is complete with that byte and is timed then.
        try:
            json.loads(self._unread)
        except ValueError:
            return
        self._recorder.received(now, self._unread)
        self._unread = b""

    async def aclose(self) -> None:
        await self._stream.aclose()
