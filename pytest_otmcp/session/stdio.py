"""Transport of MCP over a subprocess's standard input and output; records every frame (MCP basic/transports, stdio)."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import anyio
from mcp.shared.message import SessionMessage
from mcp.types import JSONRPCRequest
from pydantic import ValidationError

from .canary import STDERR
from .frames import MAX_STRAY_LINES, FrameRecorder
from .process import StopReport, SubjectProcess

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from mcp.client._transport import TransportStreams

    from .isolation import Walls

__all__ = ["StdioTransport"]

_PASSED_ON = 5

_WAITING_MESSAGES = 256
_WAITING_BYTES = 1024 * 1024
"""What may wait until the client takes it; beyond that, nothing more is read: an adapter may write faster than it is read."""


class StdioTransport:
    """Process of the subject and carrier of messages to and from it, for one session."""

    def __init__(
        self,
        command: Sequence[str],
        env: Mapping[str, str],
        cwd: Path | None,
        recorder: FrameRecorder,
        exit_grace_s: float,
        walls: Walls | None = None,
    ) -> None:
        self.process: SubjectProcess | None = None
        self.stop_report: StopReport | None = None
        self._command = command
        self._env = env
        self._cwd = cwd
        self._recorder = recorder
        self._exit_grace_s = exit_grace_s
        self._walls = walls
        self._incoming: asyncio.Queue[tuple[int, SessionMessage | Exception] | None] = asyncio.Queue()
        self._waiting_bytes = 0

    @property
    def died(self) -> bool:
        """True when the process has ended or closed its stdout, or was never started."""
        process = self.process
        return process is None or process.exited.is_set() or process.stdout_closed.is_set()

    def write_line(self, line: bytes) -> bool:
        """Write a line to the process as it is, past the client; return whether the process takes input."""
        if self.process is None or self.died:
            return False
        try:
            self.process.write(line + b"\n")
        except BrokenPipeError:
            return False
        return True

    async def stop(self) -> StopReport | None:
        """End the process if it still runs."""
        if self.process is not None and self.stop_report is None:
            self.stop_report = await self.process.stop(grace_s=self._exit_grace_s)
        return self.stop_report

    @asynccontextmanager
    async def streams(self) -> AsyncIterator[TransportStreams]:
        """Start the process and give the streams for the SDK's client; the end of the block ends the process."""
        self.process = await SubjectProcess.start(
            self._command,
            env=self._env,
            cwd=self._cwd,
            on_line=self._receive_line,
            on_overflow=self._end_at_overflow,
            on_stderr=self._recorder.secrets.stream(STDERR),
            walls=self._walls,
        )
        to_client, from_server = anyio.create_memory_object_stream[SessionMessage | Exception](0)
        from_client, to_server = anyio.create_memory_object_stream[SessionMessage](16)
        tasks = [
            asyncio.create_task(self._pump_in(to_client), name="otmcp-pump-in"),
            asyncio.create_task(self._pump_out(to_server), name="otmcp-pump-out"),
            asyncio.create_task(self._watch_end(self.process), name="otmcp-watch"),
        ]
        try:
            yield from_server, from_client
        finally:
            with anyio.CancelScope(shield=True):
                try:
                    await self.stop()
                finally:
                    # The session's task may be cancelled again while the process is ended; anyio's shield does not keep that off.
                    for task in tasks:
                        task.cancel()
                    for stream in (to_client, from_server, from_client, to_server):
                        stream.close()
                    await asyncio.gather(*tasks, return_exceptions=True)

    async def _watch_end(self, process: SubjectProcess) -> None:
        ends = [asyncio.create_task(event.wait()) for event in (process.stdout_closed, process.exited)]
        try:
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            # What a process has written before it ended is read first; a child that it leaves may keep its stdout open.
            await process.settle()
        finally:
            for end in ends:
                end.cancel()
        self._incoming.put_nowait(None)

    async def _pump_in(self, to_client: anyio.abc.ObjectSendStream[SessionMessage | Exception]) -> None:
        async with to_client:
            while (waiting := await self._incoming.get()) is not None:
                size, message = waiting
                with suppress(anyio.BrokenResourceError, anyio.ClosedResourceError):
                    await to_client.send(message)
                self._waiting_bytes -= size
                if self.process is not None and self._incoming.empty():
                    self.process.hold("client", False)

    def _pass_on(self, size: int, message: SessionMessage | Exception) -> None:
        self._waiting_bytes += size
        self._incoming.put_nowait((size, message))
        if self.process is not None and (
            self._waiting_bytes > _WAITING_BYTES or self._incoming.qsize() > _WAITING_MESSAGES
        ):
            self.process.hold("client", True)

    async def _pump_out(self, to_server: anyio.abc.ObjectReceiveStream[SessionMessage]) -> None:
        async for outgoing in to_server:
            message = outgoing.message
            data = message.model_dump_json(by_alias=True, exclude_unset=True).encode()
            if isinstance(message, JSONRPCRequest):
                self._recorder.sent(time.monotonic_ns(), data, message.id, message.params)
            process = self.process
            try:
                if process is None:
                    return
                process.write(data + b"\n")
            except BrokenPipeError:
                self._incoming.put_nowait(None)
                return

    def _receive_line(self, now: int, line: bytes) -> None:
        if not self._recorder.accepts(line):
            self._end_reading()
            return
        message = self._recorder.received(now, line.rstrip(b"\r"))
        if self._recorder.overflow:
            self._end_reading()
        elif isinstance(message, ValidationError):
            # The client takes it as an error and says so in its log; a few are enough.
            if self._recorder.stray_count + self._recorder.too_deep <= _PASSED_ON:
                self._pass_on(len(line), message)
            if self._recorder.stray_count == MAX_STRAY_LINES:
                # The session does not wait for the end of a flood: it ends here, and the finding says why.
                self._end_reading()
        elif message is not None:
            self._pass_on(len(line), SessionMessage(message))

    def _end_at_overflow(self, now: int) -> None:
        self._recorder.overflow = True
        self._end_reading()

    def _end_reading(self) -> None:
        if self.process is not None:
            self.process.stop_reading()
        self._incoming.put_nowait(None)
