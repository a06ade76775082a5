"""The link to a device: a connection made on demand, one safe repetition, no write ever sent twice.

Once the bytes of a write may have left, only the device knows whether it was executed. So no library reconnects or retries by itself here:
:func:`repeat_once` alone decides, and it repeats what was lost before a write had left. An adapter's link says how its connection is
opened, whether it can be used, and how it is ended; ``modbus/link`` is the one to read.
"""

from __future__ import annotations

import asyncio
import ssl
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable
from typing import Any, Generic, TypeVar

from .addresses import resolve
from .call import Call
from .errors import AdapterError
from .tls import handshake_failure

__all__ = ["BadReply", "DeviceLink", "Lost", "repeat_once"]

C = TypeVar("C")
T = TypeVar("T")


class BadReply(Exception):
    """What came is not the answer to the request; the text says in which respect."""


class Lost(Exception):
    """The connection ended before any byte of the answer had come.

    Attributes:
        error: the error of the call if the exchange is not repeated.
    """

    def __init__(self, error: AdapterError | None = None) -> None:
        super().__init__()
        self.error = error or AdapterError("connection_lost", "the connection broke during the call")


async def repeat_once(call: Call, attempt: Callable[[], Awaitable[T]]) -> T:
    """Make an attempt; make it a second time if the first was lost and no write of the call left during it.

    Raises:
        AdapterError: the attempt failed.
    """
    writes_before = call.writes_sent
    try:
        try:
            return await attempt()
        except Lost:
            if call.writes_sent > writes_before:
                raise
            return await attempt()
    except Lost as lost:
        raise lost.error from None


class DeviceLink(ABC, Generic[C]):
    """One connection at a time to a device, and one exchange at a time on it.

    Args:
        host, port: address of the device.
        timeout_s: seconds for connecting, and for each exchange.
        tls: for a connection over TLS; None for one in clear.

    Attributes:
        peer: what messages call the device.
        failures: what a library raises, besides OSError, when it cannot connect or a connection ends.
    """

    peer = "device"
    failures: tuple[type[Exception], ...] = ()

    def __init__(self, host: str, port: int, timeout_s: float, tls: ssl.SSLContext | None = None) -> None:
        self._host = host
        self._port = port
        self._timeout_s = timeout_s
        self._tls = tls
        self._turn = asyncio.Lock()
        self._connection: C | None = None
        self._generation = 0

    @abstractmethod
    async def _open(self) -> C:
        """Open a connection; :meth:`_connect` limits the time and explains failures."""

    @abstractmethod
    def _is_usable(self, connection: C) -> bool:
        """Tell whether the next request can be sent on a connection."""

    @abstractmethod
    def _end(self, connection: C) -> None:
        """End a connection at once."""

    async def perform(self, call: Call, exchange: Callable[[C], Awaitable[T]]) -> T:
        """Make an exchange, and a second time over a new connection where :func:`repeat_once` allows it.

        Args:
            exchange: sends the request of a call and returns the answer; it reports what it sends to the call.

        Raises:
            AdapterError: no connection, no answer, or what ``exchange`` raises.
        """
        async with self._turn:
            try:
                return await repeat_once(call, lambda: self._attempt(call, exchange))
            except asyncio.CancelledError:
                self._abandon(call, self._connection)
                raise

    async def _attempt(self, call: Call, exchange: Callable[[C], Awaitable[T]]) -> T:
        connection = await self._connected(call)
        try:
            answer = await exchange(connection)
        except AdapterError:
            # The device refuses: the connection is as good as before.
            raise
        except Exception as error:
            self._abandon(call, connection)
            raise self._explained(call, connection, error) from None
        call.answered()
        return answer

    def _abandon(self, call: Call, connection: C | None) -> None:
        # A late answer to this request must not be taken for the answer to the next one.
        self._drop(connection)
        call.disconnected()

    def _explained(self, call: Call, connection: C, error: Exception) -> Exception:
        """Return the error that a failure of an exchange is: an :class:`AdapterError`, or :class:`Lost`."""
        if isinstance(error, TimeoutError):
            return AdapterError("timeout", f"the {self.peer} did not answer within {self._timeout_s:g} s")
        if isinstance(error, BadReply):
            return AdapterError("protocol_error", f"the answer is not the one to the request: {error}")
        return Lost() if isinstance(error, (OSError, *self.failures)) else error

    async def _connected(self, call: Call) -> C:
        connection = self._connection
        if connection is not None and self._is_usable(connection):
            call.connection(generation=self._generation, fresh=False)
            return connection
        self._drop(connection)
        call.disconnected()
        self._connection = connection = await self._connect(call)
        self._generation += 1
        call.connection(generation=self._generation, fresh=True)
        return connection

    async def _connect(self, call: Call) -> C:
        await resolve(self._host, self._port)
        failures: tuple[type[Exception], ...] = (OSError, BadReply, *self.failures)
        try:
            async with asyncio.timeout(self._timeout_s):
                return await self._open()
        except failures as error:
            raise self._unreachable(error) from None

    def _unreachable(self, error: Exception) -> AdapterError:
        if self._tls is not None and (failure := handshake_failure(error, self.peer)) is not None:
            return failure
        message = f"no connection to {self._host}:{self._port}; is the {self.peer} on, and is the address right?"
        return AdapterError("connect_failed", message, outcome="not_sent")

    @property
    def _security(self) -> dict[str, Any]:
        """What asyncio's functions that connect are told of TLS."""
        return {} if self._tls is None else {"ssl": self._tls, "server_hostname": self._host}

    def _drop(self, connection: C | None) -> None:
        if connection is not None and connection is self._connection:
            self._connection = None
            self._end(connection)

    async def close(self) -> None:
        """End the connection."""
        self._drop(self._connection)
