"""The MCP side of an adapter: tools with strict arguments, write guard, deadline, and one envelope for every outcome.

It is built on the SDK's low-level server, because the high-level one coerces ``"5"`` to 5, drops unknown arguments and turns
exceptions into prose.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any, TypeVar

from mcp import MCPError
from mcp.server import Server, ServerRequestContext
from mcp.server.context import CallNext, HandlerResult
from mcp.types import (
    INVALID_PARAMS,
    SERVER_INFO_META_KEY,
    CallToolRequestParams,
    CallToolResult,
    ListToolsResult,
    PaginatedRequestParams,
)
from mcp.types.version import MODERN_PROTOCOL_VERSIONS

from .approval import InputRequired
from .arguments import parse_arguments
from .bounds import Bounds
from .call import Call, Connection
from .errors import AdapterError
from .gates import Gate, Gates, Unsettled
from .settings import Environment
from .tools import AdapterTool, tools_of

__all__ = ["AdapterServer"]

log = logging.getLogger(__name__)

T = TypeVar("T")

MOST_CALLS = 200
"""Calls of tools at the same time. More would only wait for the device until their deadline, and an assistant that is not told
so goes on calling."""
RETRY_AFTER_MS = 1000
_AGAIN_S = 0.1
"""Seconds after which a task that was cancelled and goes on is cancelled again."""

_to_json = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode


class AdapterServer:
    """An MCP server whose tools answer in envelopes.

    Args:
        name, version: the server's name and version in its introduction.
        protocol: the envelope's ``meta.protocol``.
        endpoint: URI of the device, without credentials.
        writes_enabled: True when the write guard is off.
        switch: name of the setting that enables writes, for the refusal's text.
        deadline_s: seconds within which every call answers.
        close: called once when the server ends.
    """

    def __init__(
        self,
        *,
        name: str,
        version: str,
        protocol: str,
        endpoint: str,
        writes_enabled: bool,
        switch: str,
        deadline_s: float,
        close: Callable[[], Awaitable[None]],
    ) -> None:
        self.name = name
        self.writes_enabled = writes_enabled
        self.endpoint = endpoint
        self._protocol = protocol
        self._switch = switch
        self._deadline_s = deadline_s
        self._close = close
        self._bounds = Bounds.of(Environment())
        self._gates = Gates.of(Environment(), f"{name} {version}", endpoint)
        self._present: Callable[[Call, str], Awaitable[object]] | None = None
        self._tools: dict[str, AdapterTool] = {}
        self._connection = Connection()
        self._at_work = 0
        self.mcp: Server[None] = Server(
            name,
            version=version,
            lifespan=self._lifespan,
            on_list_tools=self._list_tools,
            on_call_tool=self._call_tool,
        )
        # This replaces the SDK's OpenTelemetry middleware (measured: 17 of 186 us of a null call, for spans that are
        # not collected).
        self.mcp.middleware[:] = [self._answer_calls]
        # Every result carries these members since 2026-07-28 (basic, sections Responses and _meta).
        self._completion = {
            "resultType": "complete",
            "_meta": {SERVER_INFO_META_KEY: {"name": name, "version": version}},
        }

    @asynccontextmanager
    async def _lifespan(self, server: Server[None]) -> AsyncIterator[None]:
        try:
            yield None
        finally:
            await self._close()

    def ready(self, *, over_http: bool, has_tokens: bool) -> None:
        """Check, when all tools are there, that what the settings demand can be kept.

        Raises:
            ConfigError: it cannot.
        """
        if self._gates is not None:
            writing = [name for name, tool in self._tools.items() if tool.writes]
            has_present = self._present is not None
            self._gates.ready(writing=writing, has_present=has_present, over_http=over_http, has_tokens=has_tokens)

    def ended(self) -> None:
        """Note that the server has served its last call."""
        if self._gates is not None:
            self._gates.close()

    def add(self, group: object, *, protocol: str | None = None) -> None:
        """Offer the tools of an object: its methods that :func:`tool` declares.

        A method ``present(call, target)`` that asks the device what a target of :meth:`Call.changes` holds lets a policy have steps, and shows the
        value to the person who approves a write.

        Args:
            group: the object.
            protocol: ``meta.protocol`` of these tools, where it is not the server's.

        Raises:
            ValueError: two tools have the same name.
        """
        for tool in tools_of(group, protocol or self._protocol):
            name = tool.listing.name
            if name in self._tools:
                raise ValueError(f"there are two tools named {name}")
            self._tools[name] = tool
        self._present = getattr(group, "present", self._present)

    async def _list_tools(
        self, context: ServerRequestContext[None], params: PaginatedRequestParams | None
    ) -> ListToolsResult:
        return ListToolsResult(tools=[tool.listing for tool in self._tools.values()])

    async def _answer_calls(self, ctx: ServerRequestContext[None, Any], call_next: CallNext) -> HandlerResult:
        # The SDK would validate request and result twice each (measured: a fifth of a null call), and it answers
        # ``"arguments": [1]`` with a bare -32602; here every refusal of a known tool is an envelope. The SDK refuses
        # notifications, and clients that have not introduced themselves by handshake or by ``_meta``.
        if ctx.method == "tools/call" and ctx.request_id is not None and ctx.session.client_capabilities is not None:
            params = ctx.params or {}
            name = params.get("name")
            if isinstance(name, str) and name in self._tools:
                result = await self._answer(self._tools[name], params.get("arguments"), ctx)
                if ctx.protocol_version in MODERN_PROTOCOL_VERSIONS:
                    result = self._completion | result
                return result
        return await call_next(ctx)

    async def _call_tool(self, context: ServerRequestContext[None], params: CallToolRequestParams) -> CallToolResult:
        tool = self._tools.get(params.name)
        if tool is None:
            # Server/tools, section Error Handling: an unknown tool is a protocol error, not a result.
            raise MCPError(INVALID_PARAMS, f"Unknown tool: {params.name[:100]}")
        return CallToolResult.model_validate(await self._answer(tool, params.arguments, context))

    async def _answer(self, tool: AdapterTool, arguments: Any, context: ServerRequestContext[None]) -> dict[str, Any]:
        gate = None
        if self._gates is not None and tool.writes:
            gate = self._gates.gate(tool.listing.name, tool.operation, arguments, context)
        call = self._call(tool, gate)
        try:
            return _result(call.success(await self._perform(tool, call, arguments)))
        except InputRequired as asked:
            return asked.result
        except AdapterError as error:
            return _result(call.failure(error))
        except asyncio.CancelledError:
            task = asyncio.current_task()
            if task is not None and task.cancelling():
                call.cancelled()
                raise
            # A library has cancelled what the call waited for; passed on, this would end the session.
            return _result(call.failure(AdapterError("connection_lost", "the connection broke during the call")))
        except Exception:
            # This is a bug of the adapter: its traceback belongs in the log, not in an answer to an assistant.
            log.exception("tool %s failed unexpectedly", tool.listing.name)
            return _result(call.failure(AdapterError("internal_error", "the adapter failed unexpectedly; see its log")))

    def _call(self, tool: AdapterTool, gate: Gate | None = None, *, writes: bool | None = None) -> Call:
        return Call(
            protocol=tool.protocol,
            operation=tool.operation,
            endpoint=self.endpoint,
            writes=tool.writes if writes is None else writes,
            shared=self._connection,
            bounds=self._bounds,
            gate=gate,
        )

    async def _perform(self, tool: AdapterTool, call: Call, arguments: Any) -> dict[str, Any]:
        parsed = parse_arguments(tool.model, arguments)
        if tool.writes and not self.writes_enabled:
            raise AdapterError("writes_disabled", f"writes are disabled; set {self._switch}=true to enable them")
        while True:
            call.begin()
            try:
                return await self._in_time(lambda: tool.handler(call, parsed))
            except Unsettled as needed:
                assert call.gate is not None
                # A person may take longer than the deadline.
                await call.gate.settle(needed, self._asking(tool, call))

    def _asking(self, tool: AdapterTool, call: Call) -> Callable[[str], Awaitable[object]] | None:
        """Return what asks the device for the present value of a target of a call, where the adapter can do that."""
        present = self._present
        if present is None:
            return None

        async def ask(target: str) -> object:
            question = self._call(tool, writes=False)
            try:
                return await self._in_time(lambda: present(question, target))
            except AdapterError as error:
                message = f"what the target holds now could not be read: {error.message}"
                raise AdapterError(error.code, message, outcome="not_sent") from None
            finally:
                call.attempts += question.attempts

        return ask

    async def _in_time(self, work: Callable[[], Awaitable[T]]) -> T:
        if self._at_work >= MOST_CALLS:
            message = f"{MOST_CALLS} calls are being worked on; wait for their answers before you call again"
            raise AdapterError("rate_limited", message, outcome="not_sent", retry_after_ms=RETRY_AFTER_MS)
        self._at_work += 1
        try:
            async with asyncio.timeout(self._deadline_s) as deadline:
                with _insisting(self._deadline_s):
                    return await work()
        except TimeoutError:
            limit = f"within {self._deadline_s:g} s" if deadline.expired() else "in time"
            raise AdapterError("timeout", f"the device did not answer {limit}") from None
        finally:
            self._at_work -= 1


@contextmanager
def _insisting(deadline_s: float) -> Iterator[None]:
    """Cancel the running task again when its deadline has passed and it goes on.

    Before Python 3.12 ``asyncio.wait_for``, with which libraries connect and read, loses a cancellation that comes just when it is done
    (python/cpython issue 86296): the call would wait for another time-out.
    """
    task, loop = asyncio.current_task(), asyncio.get_running_loop()
    assert task is not None
    again: asyncio.TimerHandle

    def insist() -> None:
        nonlocal again
        task.cancel()
        # The deadline's own cancellation is the one that counts.
        task.uncancel()
        again = loop.call_later(_AGAIN_S, insist)

    again = loop.call_later(deadline_s + _AGAIN_S, insist)
    try:
        yield
    finally:
        again.cancel()


def _result(envelope: dict[str, Any]) -> dict[str, Any]:
    """Return a ``CallToolResult`` as it is on the wire.

    Raises:
        ValueError: the envelope holds a value that JSON cannot represent.
    """
    return {
        "content": [{"type": "text", "text": _to_json(envelope)}],
        "structuredContent": envelope,
        "isError": not envelope["success"],
    }
