"""The session with the server, in which requests of several calls may be under way."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, TypeVar
from urllib.parse import urlsplit

from asyncua import Client, ua
from asyncua.client.ua_client import UaClient, UaClientState
from asyncua.observer import Observer
from asyncua.ua.uaerrors import UaStatusCodeError

from ..core import AdapterError, BadReply, Call, DeviceLink, Lost, repeat_once, resolve
from .security import Security
from .status import refusal, trace_status

__all__ = ["DEFAULT_PORT", "Link", "NodeFacts", "Session"]

T = TypeVar("T")

# The library logs refusals, which are answers of the tools, and endpoints, which may contain credentials.
logging.getLogger("asyncua").setLevel(logging.CRITICAL)

DEFAULT_PORT = 4840
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
            AdapterError: a service fault.
            OSError, BadReply, Lost: no answer, an answer that is not understood, or the session ended.
        """
        if not self.alive:
            raise Lost
        token = _calling.set(call)
        call.sending(changes_state=changes)
        try:
            results = await request(self.client.uaclient)
        except UaStatusCodeError as fault:
            status = ua.StatusCode(fault.code)
            call.answered(status_code=trace_status(status))
            refused = refusal(status, writes=call.writes, changes=changes)
            if status.name in _GONE:
                # The refusal of a question says nothing of a write before it.
                raise Lost(None if call.writes_sent and not changes else refused) from None
            raise refused from None
        except OSError:
            raise
        except Exception:
            # This can be any error of the decoder: struct.error, KeyError, UaError, UnicodeDecodeError, …
            raise BadReply("it cannot be read") from None
        finally:
            _calling.reset(token)
        if len(results) != items:
            raise BadReply("it has another number of results")
        return results


class Link(DeviceLink[Session]):
    """One session at a time with an OPC UA server.

    Args:
        url: ``opc.tcp://host:port``.
        timeout_s: seconds for each step of connecting, and for each service call.
        username, password: credentials of the user; None is anonymous.
        security: of the channel; None for none.
    """

    peer = "server"

    def __init__(
        self, url: str, timeout_s: float, username: str | None, password: str | None, security: Security | None = None
    ) -> None:
        parts = urlsplit(url)
        super().__init__(parts.hostname or "", parts.port or DEFAULT_PORT, timeout_s)
        self._url = url
        self._username = username
        self._password = password
        self.security = security
        self._farewells: set[asyncio.Task[None]] = set()

    async def perform(self, call: Call, exchange: Callable[[Session], Awaitable[T]]) -> T:
        """See :meth:`DeviceLink.perform`. Answers say which request they belong to, so calls do not wait for each other."""
        return await repeat_once(call, lambda: self._attempt(call, exchange))

    async def _connected(self, call: Call) -> Session:
        async with self._turn:
            return await super()._connected(call)

    async def _open(self) -> Session:
        # It is far above the tools' timeout, so that the watchdog does not take a slow answer for a lost connection.
        client = Client(self._url, timeout=self._timeout_s, watchdog_intervall=60.0)
        client.uaclient.observer = _Wire()
        if self._username is not None:
            client.set_user(self._username)
            client.set_password(self._password or "")
        try:
            if self.security is not None:
                await self.security.prepare(client)
            await client.connect()
        except BaseException:
            client.disconnect_socket()
            raise
        return Session(client=client)

    async def _connect(self, call: Call) -> Session:
        await resolve(self._host, self._port)
        try:
            return await self._open()
        except UaStatusCodeError as fault:
            raise refusal(ua.StatusCode(fault.code), writes=call.writes) from None
        except AdapterError:
            raise
        except Exception as error:
            raise self._unreachable(error) from None

    def _is_usable(self, connection: Session) -> bool:
        return connection.alive

    def _end(self, connection: Session) -> None:
        # No call waits until the session is closed: the server may be gone.
        task = asyncio.create_task(_leave(connection.client))
        self._farewells.add(task)
        task.add_done_callback(self._farewells.discard)

    async def close(self) -> None:
        """Close the session in the server and the connection."""
        await super().close()
        if self._farewells:
            await asyncio.wait(self._farewells)


async def _leave(client: Client) -> None:
    with suppress(Exception):
        async with asyncio.timeout(_FAREWELL_S):
            await client.disconnect()
    client.disconnect_socket()
