"""One MCP session with a subject, over a stdio transport that records every frame.

The official SDK's client gives the semantics (both protocol eras, cancellation on timeout, schema validation as a
host would do it); the transport below it is ours, because a judgement needs what an ordinary client throws away:
raw bytes, the times of request and reply, stray output, stderr and the way in which the process ended.

What this file does not do: judge. It turns calls into :class:`Exchange` records.
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import anyio
from mcp import Client, MCPError
from mcp.shared.message import SessionMessage
from mcp.types import (
    JSONRPCError,
    JSONRPCNotification,
    JSONRPCRequest,
    JSONRPCResponse,
    RequestParamsMeta,
    jsonrpc_message_adapter,
)
from pydantic import ValidationError

from .errors import SubjectError
from .process import MAX_FRAME_BYTES, StopReport, SubjectProcess

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from mcp.client._transport import TransportStreams

__all__ = ["Exchange", "McpSession", "SessionOptions"]

# Ties a tools/call frame to the call that caused it, also when several run at once. ``_meta`` is the place the
# specification gives for such keys (basic, "General fields"), and servers must ignore unknown ones.
_META_KEY = "pytest-otmcp/exchange"
_MAX_STRAY_LINES = 1000
_KEPT_STRAY_LINES = 5


@dataclass(slots=True, kw_only=True)
class Exchange:
    """One ``tools/call``: what was sent, what came back, and when.

    Attributes:
        request: the request frame as written, without its newline.
        response: the response frame as read, or None when none came.
        sent_ns: monotonic time just before the request was written.
        received_ns: monotonic time at which the response line had been read, or None.
        failure: why there is no usable response (``timeout``, ``connection_closed``), or None.
        client_complaint: what the official SDK client objected to in the response, or None.
    """

    tool: str
    arguments: dict[str, Any]
    request: bytes = b""
    response: bytes | None = None
    sent_ns: int = 0
    received_ns: int | None = None
    failure: str | None = None
    client_complaint: str | None = None

    @property
    def latency_ms(self) -> float | None:
        """From request written to response line read, in milliseconds."""
        if self.received_ns is None or not self.sent_ns:
            return None
        return (self.received_ns - self.sent_ns) / 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """How sessions are opened and closed. All times in seconds."""

    era: str = "auto"
    start_timeout_s: float = 30.0
    exit_grace_s: float = 3.0


@dataclass(slots=True)
class _Recorder:
    """What the transport saw besides matched exchanges."""

    pending: dict[int, Exchange] = field(default_factory=dict)
    by_request_id: dict[Any, Exchange] = field(default_factory=dict)
    stray_count: int = 0
    stray: list[bytes] = field(default_factory=list)
    unknown_ids: list[str] = field(default_factory=list)
    known_ids: set[Any] = field(default_factory=set)
    overflow: bool = False


class McpSession:
    """An open session. Use :meth:`open` and :meth:`close`; both may be called from different tasks."""

    def __init__(self, command: Sequence[str], env: Mapping[str, str], cwd: Path | None, options: SessionOptions):
        self._command = list(command)
        self._env = dict(env)
        self._cwd = cwd
        self._options = options
        self._recorder = _Recorder()
        self._tokens = itertools.count(1)
        self._process: SubjectProcess | None = None
        self._client: Client | None = None
        self._owner: asyncio.Task[None] | None = None
        self._closing = asyncio.Event()
        self._incoming: asyncio.Queue[SessionMessage | Exception | None] = asyncio.Queue()
        self.tools: dict[str, dict[str, Any]] = {}
        self.server_name = ""
        self.server_version = ""
        self.protocol_version = ""
        self.spawned_ns = 0
        self.ready_ns = 0
        self.stop_report: StopReport | None = None

    # -- life ---------------------------------------------------------------------------------------------

    async def open(self) -> None:
        """Start the subject, agree on a protocol version and list its tools.

        Raises:
            SubjectError: the command cannot be run, the process ended, or it did not answer in time; the message
                carries its last stderr lines. The process is gone when this is raised.
        """
        ready: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.spawned_ns = time.monotonic_ns()
        self._owner = asyncio.create_task(self._own(ready), name="otmcp-session")
        try:
            await asyncio.wait_for(asyncio.shield(ready), self._options.start_timeout_s)
        except TimeoutError:
            stderr = self._stderr_excerpt()
            await self.close()
            raise SubjectError(
                "start_timeout",
                f"the adapter did not finish its handshake within {self._options.start_timeout_s:g} s "
                f"(command: {self._command_line()}){stderr}",
            ) from None
        except BaseException as error:
            await self.close()
            if isinstance(error, SubjectError | asyncio.CancelledError):
                raise
            raise SubjectError("cannot_start", self._why_not_started(error)) from error
        self.ready_ns = time.monotonic_ns()

    async def _own(self, ready: asyncio.Future[None]) -> None:
        # anyio's cancel scopes must be left by the task that entered them: this task owns the client from
        # beginning to end, whoever opens and closes the session.
        try:
            async with Client(self._transport(), cache=None, mode=self._options.era) as client:
                await self._list_tools(client)
                self._client = client
                info = client.server_info
                self.server_name, self.server_version = (info.name, info.version) if info else ("", "")
                self.protocol_version = str(client.protocol_version)
                if not ready.done():
                    ready.set_result(None)
                await self._closing.wait()
        except BaseException as error:
            if not ready.done():
                ready.set_exception(_innermost(error))
                return
            if isinstance(error, asyncio.CancelledError):
                raise
            # After a good start, what goes wrong shows in the exchanges; closing noise is not news.
        finally:
            self._client = None

    async def _list_tools(self, client: Client) -> None:
        # Listing before the first call also keeps the SDK from sending a hidden tools/list after it.
        cursor: str | None = None
        while True:
            page = await client.list_tools(cursor=cursor)
            for tool in page.tools:
                self.tools[tool.name] = tool.model_dump(by_alias=True, mode="json", exclude_none=True)
            cursor = page.next_cursor
            if cursor is None:
                return

    async def close(self) -> StopReport | None:
        """Close the session and end the process; never raises, never leaves a process behind."""
        self._closing.set()
        if self._owner is not None:
            done, _ = await asyncio.wait({self._owner}, timeout=3 * self._options.exit_grace_s + 6.0)
            if not done:
                self._owner.cancel()
                await asyncio.wait({self._owner}, timeout=5.0)
            if not self._owner.cancelled():
                self._owner.exception()
        if self._process is not None and self.stop_report is None:
            self.stop_report = await self._process.stop(grace_s=self._options.exit_grace_s)
        return self.stop_report

    # -- calls --------------------------------------------------------------------------------------------

    async def call(self, tool: str, arguments: Mapping[str, Any], *, timeout_s: float) -> Exchange:
        """Call a tool and record the exchange; every outcome is a record, none an exception."""
        exchange = Exchange(tool=tool, arguments=dict(arguments))
        client = self._client
        if client is None or self.died:
            exchange.failure = "connection_closed"
            return exchange
        token = next(self._tokens)
        self._recorder.pending[token] = exchange
        try:
            meta = cast(RequestParamsMeta, {_META_KEY: token})
            await client.call_tool(tool, dict(arguments), read_timeout_seconds=timeout_s, meta=meta)
        except MCPError as error:
            if exchange.response is None:
                timed_out = error.code == -32001 and not self.died
                exchange.failure = "timeout" if timed_out else "connection_closed"
        except (RuntimeError, ValidationError, ValueError) as error:
            exchange.client_complaint = str(error).splitlines()[0][:300]
            if exchange.response is None:
                exchange.failure = "connection_closed"
        finally:
            self._recorder.pending.pop(token, None)
        return exchange

    @property
    def died(self) -> bool:
        """The process has ended, or has closed its stdout, although nobody asked it to."""
        process = self._process
        return process is None or process.exited.is_set() or process.stdout_closed.is_set()

    async def death_note(self) -> str:
        """One sentence on how the subject ended, with its last stderr lines."""
        if self._process is None:
            return "the adapter is not running"
        await self._process.settle_stderr()
        code = self._process.returncode
        how = "closed its stdout" if code is None else _exit_words(code)
        return f"the adapter {how}{self._stderr_excerpt()}"

    def stray_output(self) -> tuple[int, list[str]]:
        """Lines on stdout that are no MCP message: how many, and the first few."""
        return self._recorder.stray_count, [line[:200].decode("utf-8", "replace") for line in self._recorder.stray]

    def unknown_responses(self) -> list[str]:
        """Ids of responses to requests that were never sent."""
        return list(self._recorder.unknown_ids)

    @property
    def overflow(self) -> bool:
        """A message longer than the kit accepts arrived; the session was ended because of it."""
        return self._recorder.overflow

    # -- transport ----------------------------------------------------------------------------------------

    @asynccontextmanager
    async def _transport(self) -> AsyncIterator[TransportStreams]:
        self._process = await SubjectProcess.start(
            self._command, env=self._env, cwd=self._cwd, on_line=self._line, on_overflow=self._overflow
        )
        to_client, from_server = anyio.create_memory_object_stream[SessionMessage | Exception](256)
        from_client, to_server = anyio.create_memory_object_stream[SessionMessage](16)
        tasks = [
            asyncio.create_task(self._pump_in(to_client), name="otmcp-pump-in"),
            asyncio.create_task(self._pump_out(to_server), name="otmcp-pump-out"),
            asyncio.create_task(self._watch_end(self._process), name="otmcp-watch"),
        ]
        try:
            yield from_server, from_client
        finally:
            with anyio.CancelScope(shield=True):
                self.stop_report = await self._process.stop(grace_s=self._options.exit_grace_s)
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
                for stream in (to_client, from_server, from_client, to_server):
                    await stream.aclose()

    async def _watch_end(self, process: SubjectProcess) -> None:
        await process.stdout_closed.wait()
        self._incoming.put_nowait(None)

    async def _pump_in(self, to_client: anyio.abc.ObjectSendStream[SessionMessage | Exception]) -> None:
        async with to_client:
            while (message := await self._incoming.get()) is not None:
                with suppress(anyio.BrokenResourceError, anyio.ClosedResourceError):
                    await to_client.send(message)

    async def _pump_out(self, to_server: anyio.abc.ObjectReceiveStream[SessionMessage]) -> None:
        async for outgoing in to_server:
            message = outgoing.message
            data = message.model_dump_json(by_alias=True, exclude_unset=True).encode()
            if isinstance(message, JSONRPCRequest):
                self._recorder.known_ids.add(message.id)
                token = ((message.params or {}).get("_meta") or {}).get(_META_KEY)
                exchange = self._recorder.pending.get(token) if isinstance(token, int) else None
                if exchange is not None:
                    self._recorder.by_request_id[message.id] = exchange
                    exchange.request = data
                    exchange.sent_ns = time.monotonic_ns()
            process = self._process
            try:
                if process is None:
                    return
                process.write(data + b"\n")
            except BrokenPipeError:
                self._incoming.put_nowait(None)
                return

    def _line(self, now: int, line: bytes) -> None:
        line = line.rstrip(b"\r")
        try:
            message = jsonrpc_message_adapter.validate_json(line)
        except ValidationError as error:
            self._stray(line)
            if self._recorder.stray_count <= _MAX_STRAY_LINES:
                self._incoming.put_nowait(error)
            return
        if isinstance(message, JSONRPCResponse | JSONRPCError):
            exchange = self._recorder.by_request_id.pop(message.id, None)
            if exchange is not None:
                exchange.response = line
                exchange.received_ns = now
            elif message.id not in self._recorder.known_ids and len(self._recorder.unknown_ids) < _KEPT_STRAY_LINES:
                self._recorder.unknown_ids.append(repr(message.id))
        elif not isinstance(message, JSONRPCRequest | JSONRPCNotification):
            return
        self._incoming.put_nowait(SessionMessage(message))

    def _stray(self, line: bytes) -> None:
        self._recorder.stray_count += 1
        if len(self._recorder.stray) < _KEPT_STRAY_LINES:
            self._recorder.stray.append(line)
        if self._recorder.stray_count == _MAX_STRAY_LINES:
            # A flood is not waited out: the session ends here, and the finding says why.
            self._incoming.put_nowait(None)

    def _overflow(self, now: int) -> None:
        self._recorder.overflow = True
        self._incoming.put_nowait(None)

    # -- words --------------------------------------------------------------------------------------------

    def _command_line(self) -> str:
        return " ".join(self._command)

    def _stderr_excerpt(self) -> str:
        tail = self._process.stderr_tail() if self._process is not None else []
        return "; last stderr lines:\n    " + "\n    ".join(tail) if tail else "; it wrote nothing to stderr"

    def _why_not_started(self, error: BaseException) -> str:
        if isinstance(error, FileNotFoundError):
            return f"the command {self._command[0]!r} was not found; the launch command is: {self._command_line()}"
        if isinstance(error, OSError):
            return f"the command cannot be executed ({error.strerror or error}): {self._command_line()}"
        if self._recorder.overflow:
            return f"the adapter sent a line of more than {MAX_FRAME_BYTES // 2**20} MiB during its handshake"
        if self._recorder.stray_count >= _MAX_STRAY_LINES:
            first = self._recorder.stray[0][:120].decode("utf-8", "replace")
            return f"the adapter floods stdout with lines that are no MCP messages, the first: {first!r}"
        report = self.stop_report
        if report is not None and report.how == "exited":
            how = _exit_words(report.returncode)
            return f"the adapter {how} during its handshake ({self._command_line()}){self._stderr_excerpt()}"
        reason = str(error).splitlines()[0][:300] if str(error) else type(error).__name__
        return f"the adapter's handshake failed: {reason} ({self._command_line()}){self._stderr_excerpt()}"


def _exit_words(code: int | None) -> str:
    if code is None:
        return "did not exit"
    return f"was killed by signal {-code}" if code < 0 else f"exited with code {code}"


def _innermost(error: BaseException) -> BaseException:
    while isinstance(error, BaseExceptionGroup) and error.exceptions:
        error = error.exceptions[0]
    return error
