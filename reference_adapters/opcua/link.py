"""The session with the server: made on demand, replaced when it is lost, a request never repeated if it may have
changed something."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from asyncua import Client, ua
from asyncua.client.ua_client import UaClient, UaClientState
from asyncua.ua.uaerrors import UaError, UaStatusCodeError

from ..core import AdapterError, Call
from .status import refusal, trace_status

__all__ = ["Link", "NodeFacts"]

T = TypeVar("T")

# The library logs refusals, which are answers here, and endpoints, which may carry credentials.
logging.getLogger("asyncua").setLevel(logging.CRITICAL)

_GONE = {
    "BadSessionIdInvalid",
    "BadSessionClosed",
    "BadSecureChannelIdInvalid",
    "BadSecureChannelClosed",
    "BadConnectionClosed",
    "BadShutdown",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeFacts:
    """What must be known of a node before it can be written: its built-in type and value rank."""

    kind: ua.VariantType
    rank: int


class Link:
    """One session, and what was learnt in it about the server."""

    def __init__(self, url: str, timeout_s: float, username: str | None, password: str | None) -> None:
        self._url = url
        self._timeout_s = timeout_s
        self._username = username
        self._password = password
        self._lock = asyncio.Lock()
        self._client: Client | None = None
        self._ending: asyncio.Task[None] | None = None
        self.generation = 0
        # Valid for one session only: after a restart the same identifier may mean another node.
        self.facts: dict[ua.NodeId, NodeFacts] = {}
        self.inputs: dict[ua.NodeId, list[ua.VariantType]] = {}

    async def service(self, call: Call, request: Callable[[UaClient], Awaitable[T]], *, changes: bool = False) -> T:
        """Perform one service call.

        Args:
            call: the tool call it is made for.
            request: makes the service call on a connected client.
            changes: it is a Write or Call: never repeated.

        Raises:
            AdapterError: no connection, no answer, or a service fault.
        """
        try:
            return await self._attempt(call, request)
        except _LostError:
            if changes:
                raise AdapterError("connection_lost", "the connection broke while the request was under way") from None
        try:
            return await self._attempt(call, request)
        except _LostError:
            raise AdapterError("connection_lost", "the connection broke during the call") from None

    async def _attempt(self, call: Call, request: Callable[[UaClient], Awaitable[T]]) -> T:
        client, fresh = await self._connected()
        call.connection(generation=self.generation, fresh=fresh)
        call.sending()
        try:
            return await request(client.uaclient)
        except UaStatusCodeError as fault:
            status = ua.StatusCode(fault.code)
            if status.name in _GONE:
                await self._drop(call)
                raise _LostError from fault
            call.answered(status_code=trace_status(status))
            raise refusal(status, writes=call.writes) from fault
        except (ConnectionError, UaError, OSError) as fault:
            await self._drop(call)
            raise _LostError from fault
        except TimeoutError:
            await self._drop(call)
            raise AdapterError("timeout", f"no answer within {self._timeout_s:g} s") from None

    async def _connected(self) -> tuple[Client, bool]:
        async with self._lock:
            client = self._client
            if client is not None and client.uaclient.state == UaClientState.CONNECTED:
                return client, False
            await self._drop(None)
            # The watchdog must not mistake a slow answer for a lost connection: far above the tool's timeout.
            client = Client(self._url, timeout=self._timeout_s, watchdog_intervall=60.0)
            if self._username is not None:
                client.set_user(self._username)
                client.set_password(self._password or "")
            try:
                await client.connect()
            except UaStatusCodeError as fault:
                raise refusal(ua.StatusCode(fault.code), writes=False) from None
            except (OSError, TimeoutError, UaError):
                raise AdapterError(
                    "connect_failed", "no connection to the server could be made", outcome="not_sent"
                ) from None
            self._client = client
            self.generation += 1
            return client, True

    async def _drop(self, call: Call | None) -> None:
        client, self._client = self._client, None
        self.facts.clear()
        self.inputs.clear()
        if call is not None:
            call.disconnected()
        if client is not None:
            # A lost connection cannot be closed politely, and trying to must not cost the call its time.
            self._ending = asyncio.create_task(_quietly(client.disconnect()))
            client.disconnect_socket()

    async def close(self) -> None:
        """Close the session at the server, too."""
        client, self._client = self._client, None
        if client is not None:
            await asyncio.wait({asyncio.create_task(_quietly(client.disconnect()))}, timeout=1.0)


class _LostError(Exception):
    """The connection or session ended during the call."""


async def _quietly(work: Awaitable[Any]) -> None:
    try:
        await work
    except (OSError, UaError, TimeoutError, asyncio.CancelledError):
        return
