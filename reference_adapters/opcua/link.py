"""The session with the server: made on demand, replaced when it is lost. A request that may have changed the plant is never
repeated."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, TypeVar

from asyncua import Client, ua
from asyncua.client.ua_client import UaClient, UaClientState
from asyncua.observer import Observer
from asyncua.ua.uaerrors import UaStatusCodeError

from ..core import AdapterError, Call
from .status import refusal, trace_status

__all__ = ["Link", "NodeFacts", "Session"]

T = TypeVar("T")

# The library logs refusals, which are answers of the tools, and endpoints, which may contain credentials.
logging.getLogger("asyncua").setLevel(logging.CRITICAL)

_FAREWELL_S = 2.0
_GONE = {
    "BadSessionIdInvalid",
    "BadSessionClosed",
    "BadSessionNotActivated",
    "BadSecureChannelIdInvalid",
    "BadSecureChannelClosed",
    "BadConnectionClosed",
    "BadShutdown",
}

_calling: ContextVar[Call] = ContextVar("calling")


class _Wire(Observer):  # type: ignore[misc]
    """The observer that notes the handle of every request made for a tool call."""

    @contextmanager
    def observe_request(self, request: Any) -> Iterator[None]:
        try:
            yield
        finally:
            call = _calling.get(None)
            if call is not None:
                call.trace.setdefault("request_handles", []).append(request.RequestHeader.RequestHandle)


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeFacts:
    """Type and shape of a variable, which must be known before it can be written.

    Attributes:
        kind: its built-in type.
        rank, dimensions: its ValueRank and ArrayDimensions (OPC 10000-3, 5.6.2).
    """

    kind: ua.VariantType
    rank: int = -1
    dimensions: Sequence[int] = ()


@dataclass(slots=True, kw_only=True, eq=False)
class Session:
    """One session, and the facts about the server that were read in it.

    These facts are valid for this session only: after a restart the same identifier may mean another node, and the same
    namespace may have another index. So a request that was prepared in one session is never sent in another.
    """

    client: Client
    timeout_s: float
    generation: int
    facts: dict[ua.NodeId, NodeFacts] = field(default_factory=dict)
    types: dict[ua.NodeId, ua.VariantType] = field(default_factory=dict)
    inputs: dict[ua.NodeId, list[NodeFacts]] = field(default_factory=dict)
    leaves: set[ua.NodeId] = field(default_factory=set)
    branches: list[ua.NodeId] = field(default_factory=list)
    namespaces: list[str] | None = None
    limits: dict[str, int] | None = None

    @property
    def alive(self) -> bool:
        """True when requests can be sent."""
        return bool(self.client.uaclient.state == UaClientState.CONNECTED)

    async def request(
        self, call: Call, request: Callable[[UaClient], Awaitable[list[T]]], *, items: int, changes: bool = False
    ) -> list[T]:
        """Make one service call.

        Args:
            call: the tool call that needs it.
            request: makes the service call.
            items: number of results that the answer must have.
            changes: the service is Write or Call.

        Raises:
            AdapterError: a service fault, no answer, or an answer that is not understood.
            LostError: the session ended.
        """
        if not self.alive:
            raise LostError(AdapterError("connection_lost", "the connection broke"), sent=False)
        token = _calling.set(call)
        call.sending(changes_state=changes)
        try:
            results = await request(self.client.uaclient)
            if len(results) != items:
                raise ValueError
        except Exception as fault:
            raise self._failure(call, fault, changes=changes) from None
        finally:
            _calling.reset(token)
        return results

    def _failure(self, call: Call, fault: Exception, *, changes: bool) -> AdapterError | LostError:
        if isinstance(fault, UaStatusCodeError):
            status = ua.StatusCode(fault.code)
            call.answered(status_code=trace_status(status))
            refused = refusal(status, writes=call.writes, changes=changes)
            return LostError(refused, sent=changes) if status.name in _GONE else refused
        if isinstance(fault, TimeoutError):
            # A silent server may not come back, so the next call begins with a new connection.
            error = AdapterError("timeout", f"the server did not answer within {self.timeout_s:g} s")
            return LostError(error, sent=True)
        if isinstance(fault, OSError):
            error = AdapterError("connection_lost", "the connection broke during the call")
            return LostError(error, sent=changes)
        # This can be any error of the decoder: struct.error, KeyError, UaError, UnicodeDecodeError, …
        error = AdapterError("protocol_error", "the server's answer is not the answer to the request")
        return LostError(error, sent=True)


class LostError(Exception):
    """The session cannot be used any longer.

    Attributes:
        error: the error of the call if the work is not repeated.
        sent: True when the work must not be repeated.
    """

    def __init__(self, error: AdapterError, *, sent: bool) -> None:
        super().__init__(error.message)
        self.error = error
        self.sent = sent


class Link:
    """One session at a time with an OPC UA server.

    Args:
        url: ``opc.tcp://host:port``.
        timeout_s: seconds for each step of connecting, and for each service call.
        username, password: credentials of the user; None is anonymous.
    """

    def __init__(self, url: str, timeout_s: float, username: str | None, password: str | None) -> None:
        self._url = url
        self._timeout_s = timeout_s
        self._username = username
        self._password = password
        self._lock = asyncio.Lock()
        self._session: Session | None = None
        self._farewells: set[asyncio.Task[None]] = set()
        self._generation = 0

    async def perform(self, call: Call, work: Callable[[Session], Awaitable[T]]) -> T:
        """Do work in a session; repeat it once in a new one if the session was lost before anything was changed.

        Raises:
            AdapterError: no connection, or the error that ``work`` raised.
        """
        try:
            return await self._attempt(call, work)
        except LostError as lost:
            if lost.sent:
                raise lost.error from None
        try:
            return await self._attempt(call, work)
        except LostError as lost:
            raise lost.error from None

    async def _attempt(self, call: Call, work: Callable[[Session], Awaitable[T]]) -> T:
        session = await self._connected(call)
        try:
            return await work(session)
        except LostError:
            self._drop(session)
            call.disconnected()
            raise

    async def _connected(self, call: Call) -> Session:
        session, fresh = self._session, False
        if session is None or not session.alive:
            async with self._lock:
                session, fresh = self._session, False
                if session is None or not session.alive:
                    if session is not None:
                        self._drop(session)
                    call.disconnected()
                    session, fresh = await self._connect(call), True
        call.connection(generation=session.generation, fresh=fresh)
        return session

    async def _connect(self, call: Call) -> Session:
        # It is far above the tools' timeout, so that the watchdog does not take a slow answer for a lost connection.
        client = Client(self._url, timeout=self._timeout_s, watchdog_intervall=60.0)
        client.uaclient.observer = _Wire()
        if self._username is not None:
            client.set_user(self._username)
            client.set_password(self._password or "")
        try:
            await client.connect()
        except BaseException as fault:
            client.disconnect_socket()
            if isinstance(fault, Exception):
                raise _not_connected(call, fault) from None
            raise
        self._generation += 1
        self._session = Session(client=client, timeout_s=self._timeout_s, generation=self._generation)
        return self._session

    def _drop(self, session: Session) -> None:
        if self._session is session:
            self._session = None
            # No call waits until the session is closed: the server may be gone.
            task = asyncio.create_task(_leave(session.client))
            self._farewells.add(task)
            task.add_done_callback(self._farewells.discard)

    async def close(self) -> None:
        """Close the session in the server and the connection."""
        if self._session is not None:
            self._drop(self._session)
        if self._farewells:
            await asyncio.wait(self._farewells)


async def _leave(client: Client) -> None:
    with suppress(Exception):
        async with asyncio.timeout(_FAREWELL_S):
            await client.disconnect()
    client.disconnect_socket()


def _not_connected(call: Call, fault: Exception) -> AdapterError:
    if isinstance(fault, UaStatusCodeError):
        return refusal(ua.StatusCode(fault.code), writes=call.writes)
    if isinstance(fault, socket.gaierror):
        return AdapterError("dns_error", "the server's host name cannot be resolved", outcome="not_sent")
    message = "no connection to the server could be made; is it on, and is the address right?"
    return AdapterError("connect_failed", message, outcome="not_sent")
