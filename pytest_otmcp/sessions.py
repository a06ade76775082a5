"""Sessions with the subject's adapters in a vendor's own tests: handles, and what a call came to.

A session is a fresh process of the adapter, launched as the subject file says and pointed at the mock device of the test.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Callable, Coroutine, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

from .envelope import check_result, parse_strict
from .errors import UsageError
from .fixture_handle import Handle
from .loop import LoopThread
from .mcp_session import Exchange
from .observation import Reply
from .station import NoBindingError, Station
from .subject.answers import interpret, read_answer
from .subject.operations import OPERATIONS

__all__ = ["AsyncSession", "AsyncSessionFactory", "Session", "SessionFactory", "ToolReply", "unknown"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolReply:
    """What one call came to, as the adapter says. What the device says is in its journal and image.

    Attributes:
        tool, arguments: what was called.
        success: what the adapter claims; None when it gave no answer, or one that is no envelope where one is due.
        envelope: the adapter's own, or one that is made from its answer by the rules of the subject file; of a raw tool
            of an adapter without envelopes None.
        structured: the result's ``structuredContent``, whatever it is.
        outputs: of an operation, where the subject file says how to find them.
        error_code: of a failure, or None.
        text: the result's text blocks, a line each; of a JSON-RPC error its message.
        latency_ms: request written to response read; None without a response.
        faults: what is wrong with the answer as such, a sentence each: no reply, no envelope, late ….
    """

    tool: str
    arguments: Mapping[str, Any]
    success: bool | None
    envelope: dict[str, Any] | None
    structured: Any
    outputs: Mapping[str, Any]
    error_code: str | None
    text: str
    latency_ms: float | None
    faults: tuple[str, ...]


def unknown(what: str, name: str, known: Iterable[str]) -> str:
    """The sentence for a name that does not exist."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, 1)
    return f"there is no {what} {name!r}; " + (
        f"did you mean {near[0]!r}?" if near else f"known are {', '.join(names)}"
    )


def _message(response: bytes | None) -> dict[str, Any] | None:
    try:
        message = parse_strict(response) if response is not None else None
    except ValueError:
        return None
    return message if isinstance(message, dict) else None


class _Calls:
    """A session's calls; runs on the kit's loop."""

    def __init__(self, station: Station) -> None:
        self.station = station
        self._where = f"session of {station.adapter.protocol}"

    async def operation(self, operation: str, inputs: dict[str, Any]) -> ToolReply:
        known = OPERATIONS[self.station.adapter.protocol]
        if operation not in known:
            self._refuse(unknown("operation", operation, known))
        takes = known[operation]
        missing = [name for name in takes.inputs if name not in inputs and name not in takes.optional]
        if missing or not set(inputs) <= set(takes.inputs):
            self._refuse(
                f"{operation} takes {', '.join(takes.inputs) or 'no inputs'}; given: {', '.join(inputs) or 'none'}"
            )
        self._alive()
        try:
            reply = await self.station.call(operation, role="task", **inputs)
        except NoBindingError as gap:
            self._refuse(str(gap))
        return _of_operation(reply)

    async def tool(self, tool: str, arguments: dict[str, Any]) -> ToolReply:
        session = self._alive()
        exchange = await session.call(tool, arguments, timeout_s=self.station.deadline_s)
        return self._of_tool(exchange)

    def _of_tool(self, exchange: Exchange) -> ToolReply:
        message, answering = _message(exchange.response), self.station.adapter.answering
        faults = [exchange.client_complaint] if exchange.client_complaint else []
        envelope: dict[str, Any] | None = None
        structured, text, success, code = None, "", None, None
        if exchange.response is None:
            deadline = f"no reply within the deadline of {self.station.deadline_s:g} s"
            faults.append(deadline if exchange.failure == "timeout" else "no reply, the session ended")
        elif message is None:
            faults.append("the response is not strict JSON")
        else:
            structured, text, _ = read_answer(message, "structured")
            if not answering.native:
                answer = interpret(message, answering)
                success, code = answer.success, answer.code
            elif "error" in message:
                faults.append(f"answered with a JSON-RPC error instead of a tool result: {text}")
            else:
                faults += [fault.message for fault in check_result(message["result"])]
                envelope = structured if isinstance(structured, dict) else None
                success, code = _stated(envelope)
        return ToolReply(
            tool=exchange.tool,
            arguments=exchange.arguments,
            success=success,
            envelope=envelope,
            structured=structured,
            outputs={},
            error_code=code,
            text=text,
            latency_ms=exchange.latency_ms,
            faults=tuple(faults),
        )

    def _alive(self) -> Any:
        session = self.station.session
        if session is None:
            self._refuse("it was closed")
        return session

    def _refuse(self, why: str) -> NoReturn:
        raise UsageError(f"{self._where}: {why}")


def _stated(envelope: Mapping[str, Any] | None) -> tuple[bool | None, str | None]:
    success = (envelope or {}).get("success")
    error = (envelope or {}).get("error")
    code = error.get("code") if isinstance(error, dict) else None
    return success if isinstance(success, bool) else None, code if isinstance(code, str) else None


def _of_operation(reply: Reply) -> ToolReply:
    message = _message(reply.wire.response)
    structured, text, _ = read_answer(message, "structured") if message is not None else (None, "", False)
    return ToolReply(
        tool=reply.tool,
        arguments=json.loads(json.dumps(dict(reply.arguments), default=str)),
        success=reply.success,
        envelope=reply.envelope,
        structured=structured,
        outputs=reply.outputs,
        error_code=reply.error_code,
        text=text,
        latency_ms=reply.latency_ms,
        faults=tuple(fault.message for fault in reply.faults),
    )


class _Handle(Handle):
    """What both forms of a session have."""

    def __init__(self, loop: LoopThread, calls: _Calls) -> None:
        super().__init__(loop)
        self._calls = calls

    @property
    def protocol(self) -> str:
        """``modbus``, ``mqtt`` or ``opcua``."""
        return self._calls.station.adapter.protocol

    @property
    def tools(self) -> tuple[str, ...]:
        """Names of the tools that the adapter lists."""
        session = self._calls.station.session
        return tuple(session.tools) if session is not None else ()

    def __repr__(self) -> str:
        station = self._calls.station
        return (
            f"<{type(self).__name__} {self.protocol} {station.variant}{', closed' if station.session is None else ''}>"
        )


class AsyncSession(_Handle):
    """A session in asynchronous tests; the methods do what those of :class:`Session` do."""

    async def call(self, operation: str, /, **inputs: Any) -> ToolReply:
        """See :meth:`Session.call`."""
        __tracebackhide__ = True
        return await self._wait(self._calls.operation(operation, inputs))

    async def tool(self, name: str, /, **arguments: Any) -> ToolReply:
        """See :meth:`Session.tool`."""
        __tracebackhide__ = True
        return await self._wait(self._calls.tool(name, arguments))

    async def close(self) -> None:
        """See :meth:`Session.close`."""
        __tracebackhide__ = True
        await self._wait(self._calls.station.close())


class Session(_Handle):
    """An open session with an adapter at the mock device of the test; it is closed with the test."""

    def __init__(self, loop: LoopThread, station: Station) -> None:
        super().__init__(loop, _Calls(station))
        self.aio = AsyncSession(loop, self._calls)

    def call(self, operation: str, /, **inputs: Any) -> ToolReply:
        """Perform an abstract operation through whatever tool the subject file binds to it.

        Raises:
            UsageError: there is no such operation, it has other inputs, or nothing is bound to it.
        """
        __tracebackhide__ = True
        return self._do(self._calls.operation(operation, inputs))

    def tool(self, name: str, /, **arguments: Any) -> ToolReply:
        """Call a tool by its own name, with its own arguments; also one that does not exist."""
        __tracebackhide__ = True
        return self._do(self._calls.tool(name, arguments))

    def close(self) -> None:
        """End the session and the adapter's process."""
        __tracebackhide__ = True
        self._do(self._calls.station.close())


_Open = Callable[[str, str], Coroutine[Any, Any, Session]]
"""Opens a session with the adapter of a protocol in a variant; runs on the kit's loop."""


class AsyncSessionFactory(Handle):
    """``await otmcp_session.aio("modbus")``: what :class:`SessionFactory` does, for asynchronous tests."""

    def __init__(self, loop: LoopThread, opened: _Open) -> None:
        super().__init__(loop)
        self._opened = opened

    async def __call__(self, protocol: str, *, variant: str = "rw") -> AsyncSession:
        """See :meth:`SessionFactory.__call__`."""
        __tracebackhide__ = True
        return (await self._wait(self._opened(protocol, variant))).aio


class SessionFactory(Handle):
    """``otmcp_session("modbus")``: opens sessions."""

    def __init__(self, loop: LoopThread, opened: _Open) -> None:
        super().__init__(loop)
        self._opened = opened
        self.aio = AsyncSessionFactory(loop, opened)

    def __call__(self, protocol: str, *, variant: str = "rw") -> Session:
        """Start the subject's adapter of a protocol and open a session with it.

        Args:
            protocol: ``modbus``, ``mqtt`` or ``opcua``; the adapter talks to the device of the same test's fixture.
            variant: ``rw`` with writes enabled, ``ro`` with writes disabled.

        Raises:
            UsageError: the subject has no adapter for the protocol, or there is no such variant.
            SubjectError: the adapter cannot be started; the message has its last words.
        """
        __tracebackhide__ = True
        return self._do(self._opened(protocol, variant))
