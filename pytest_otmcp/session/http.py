"""MCP over streamable HTTP to a subprocess, every frame recorded (MCP basic/transports, Streamable HTTP).

The SDK's own client transport carries the messages; below it, where requests and responses are bytes, sits a recorder.
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

from .frames import FrameRecorder
from .process import MAX_FRAME_BYTES, StopReport, SubjectProcess

if TYPE_CHECKING:
    from mcp.client._transport import TransportStreams

__all__ = ["HttpTransport"]

_POLL_S = 0.02
"""How often a starting server is asked whether it accepts connections; it has no way to tell."""

# A call's own deadline is the session's business; these only keep a dead connection from being waited for.
_TIMEOUT = httpx2.Timeout(30.0, read=330.0)


class HttpTransport:
    """Starts the subject and carries messages to and from its URL. For one session."""

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
        """The process has ended although nobody asked it to."""
        return self.process is None or self.process.exited.is_set()

    async def stop(self) -> StopReport | None:
        """End the process, if it is still there; a server on the network is asked by SIGTERM."""
        if self.process is not None and self.stop_report is None:
            self.stop_report = await self.process.stop(grace_s=self._exit_grace_s, reads_stdin=False)
        return self.stop_report

    @asynccontextmanager
    async def streams(self) -> AsyncIterator[TransportStreams]:
        """The streams for the SDK's client; the process lives as long as the block."""
        self.process = await SubjectProcess.start(
            self._command,
            env=self._env,
            cwd=self._cwd,
            # What a server on the network prints is its own business.
            on_line=lambda now, line: None,
            on_overflow=lambda now: None,
        )
        try:
            await self._accepts(self.process)
            recording = _RecordingTransport(self._recorder)
            async with (
                httpx2.AsyncClient(transport=recording, timeout=_TIMEOUT) as client,
                streamable_http_client(self._url, http_client=client) as streams,
            ):
                yield streams
        finally:
            await asyncio.shield(self.stop())

    async def _accepts(self, process: SubjectProcess) -> None:
        parts = urlsplit(self._url)
        while not process.exited.is_set():
            try:
                _, writer = await asyncio.open_connection(parts.hostname, parts.port or 80)
            except OSError:
                await asyncio.sleep(_POLL_S)
                continue
            writer.close()
            return
        raise ConnectionError(f"the process ended before {self._url} accepted a connection")


class _RecordingTransport(httpx2.AsyncBaseTransport):
    """Hands every JSON-RPC message that passes to the recorder."""

    def __init__(self, recorder: FrameRecorder) -> None:
        # The environment's proxies have no business between two processes of one machine.
        self._below = httpx2.AsyncHTTPTransport(trust_env=False)
        self._recorder = recorder

    async def handle_async_request(self, request: httpx2.Request) -> httpx2.Response:
        body = await request.aread()
        if request.method == "POST" and body:
            message = json.loads(body)
            if "id" in message and "method" in message:
                self._recorder.sent(time.monotonic_ns(), body, message["id"], message.get("params"))
        response = await self._below.handle_async_request(request)
        kind = response.headers.get("content-type", "").partition(";")[0].strip()
        assert isinstance(response.stream, httpx2.AsyncByteStream)
        if kind in ("application/json", "text/event-stream"):
            response.stream = _Recorded(response.stream, self._recorder, events=kind == "text/event-stream")
        return response

    async def aclose(self) -> None:
        await self._below.aclose()


class _Recorded(httpx2.AsyncByteStream):
    """A response body that is recorded while it is read: one JSON message, or server-sent events with one each."""

    def __init__(self, stream: httpx2.AsyncByteStream, recorder: FrameRecorder, *, events: bool) -> None:
        self._stream = stream
        self._recorder = recorder
        self._events = events
        self._unread = b""
        self._data: list[bytes] = []

    async def __aiter__(self) -> AsyncIterator[bytes]:
        async for chunk in self._stream:
            # Before the client sees it: the call must find its response recorded when it returns.
            self._take(chunk)
            yield chunk
        if not self._events and self._unread:
            self._recorder.received(time.monotonic_ns(), self._unread)

    def _take(self, chunk: bytes) -> None:
        now = time.monotonic_ns()
        self._unread += chunk
        if len(self._unread) > MAX_FRAME_BYTES:
            self._recorder.overflow = True
            raise httpx2.ReadError("the adapter sent a message longer than the kit reads")
        if not self._events:
            self._take_whole(now)
            return
        *lines, self._unread = self._unread.split(b"\n")
        for line in map(bytes.strip, lines):
            if line.startswith(b"data:"):
                self._data.append(line[5:].removeprefix(b" "))
            elif not line and self._data:
                frame, self._data = b"\n".join(self._data), []
                if frame:
                    self._recorder.received(now, frame)

    def _take_whole(self, now: int) -> None:
        # The end of a body comes after its last byte; the reply is there with that byte.
        try:
            json.loads(self._unread)
        except ValueError:
            return
        self._recorder.received(now, self._unread)
        self._unread = b""

    async def aclose(self) -> None:
        await self._stream.aclose()
