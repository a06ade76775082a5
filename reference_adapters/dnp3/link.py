"""The way to the outstations: a connection made on demand, one request at a time, no command ever sent twice."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from typing import TypeVar

from dnp3.core.enums import FunctionCode
from dnp3.core.flags import IIN

from ..core import AdapterError, Call, resolve
from .connection import Connection, Lost, Response
from .objects import BadReply, Point
from .refusals import refused

__all__ = ["Link"]

_SEQUENCES = 16
_MOST_KEPT = 1000
"""Events per outstation that wait for somebody who polls."""
_CLEAR_RESTART = bytes([80, 1, 0, 7, 7, 0])
"""Internal indications (g80v1), index 7 to 7: zero."""

T = TypeVar("T")
Check = Callable[[Response], None]
Step = tuple[int, bytes]
"""A function code and the objects of a request."""


class Link:
    """One connection at a time.

    Args:
        host, port: of the outstation or its gateway.
        master: own link address.
        timeout_s: seconds for connecting, and for each fragment of an answer.
        known: link addresses of the outstations that may send events unasked.
        clears_restart: the indication that an outstation has restarted is cleared when it has been seen.
    """

    def __init__(
        self, host: str, port: int, master: int, timeout_s: float, *, known: set[int], clears_restart: bool
    ) -> None:
        self._host = host
        self._port = port
        self._master = master
        self._timeout_s = timeout_s
        self._known = known
        self._clears_restart = clears_restart
        self._lock = asyncio.Lock()
        self._connection: Connection | None = None
        self._generation = 0
        # They go on over connections: an outstation takes a request with the number of its last one for a repetition.
        self._sequences: dict[int, int] = {}
        self._kept: dict[int, list[Point]] = {}
        self._cleared: set[int] = set()

    # -- events that nobody has asked for ---------------------------------------------------------------------

    def _keep(self, outstation: int, points: list[Point]) -> bool:
        kept = self._kept.setdefault(outstation, [])
        if len(kept) + len(points) > _MOST_KEPT:
            return False
        kept += points
        return True

    def kept(self, outstation: int) -> list[Point]:
        """Return what an outstation has told unasked, oldest first, and forget it."""
        return self._kept.pop(outstation, [])

    # -- requests ---------------------------------------------------------------------------------------------

    async def ask(self, call: Call, outstation: int, function: int, objects: bytes) -> Response:
        """Send a request that changes nothing, and return its answer.

        A request that finds the connection dead is repeated once over a new one.

        Raises:
            AdapterError: no connection, no answer, another answer than the request's, or a refusal.
        """
        return await self._exchange(call, outstation, [(function, objects)], _nothing_to_check, changes_state=False)

    async def command(self, call: Call, outstation: int, steps: Sequence[Step], check: Check) -> Response:
        """Send requests that change something, one directly after the other, each once; return the last answer.

        Args:
            check: raises an error for an answer that does not allow the next step, or is no success.

        Raises:
            AdapterError: see :meth:`ask`, or what ``check`` raises.
        """
        return await self._exchange(call, outstation, steps, check, changes_state=True)

    async def _exchange(
        self, call: Call, outstation: int, steps: Sequence[Step], check: Check, *, changes_state: bool
    ) -> Response:
        async def all_steps() -> Response:
            for function, objects in steps:
                response = await self._step(call, outstation, function, objects, changes_state)
                check(response)
            return response

        async with self._lock:
            response = await self._repeated(call, all_steps)
            if response.indications & IIN.DEVICE_RESTART and outstation not in self._cleared and self._clears_restart:
                await self._clear(call, outstation)
        return response

    async def _step(self, call: Call, outstation: int, function: int, objects: bytes, changes_state: bool) -> Response:
        response = await self._send(call, outstation, function, objects, changes_state)
        call.trace["iin"] = response.indications
        call.trace["indications"] = [bit.name for bit in IIN if bit & response.indications]
        if (error := refused(call, response.indications)) is not None:
            raise error
        return response

    async def _send(self, call: Call, outstation: int, function: int, objects: bytes, changes_state: bool) -> Response:
        sequence = self._sequences[outstation] = (self._sequences.get(outstation, -1) + 1) % _SEQUENCES
        connection = await self._connected(call)
        call.trace["outstation"] = outstation
        call.trace.setdefault("functions", []).append(int(function))
        call.trace.setdefault("sequences", []).append(sequence)
        call.sending(changes_state=changes_state)
        return await self._guarded(call, connection.ask(outstation, sequence, function, objects, self._timeout_s))

    async def status(self, call: Call, outstation: int) -> None:
        """Ask the data link layer of an outstation whether it is there.

        Raises:
            AdapterError: no connection, or no answer.
        """

        async def once() -> None:
            connection = await self._connected(call)
            call.trace["outstation"] = outstation
            call.sending(changes_state=False)
            await self._guarded(call, connection.ask_link_status(outstation, self._timeout_s))

        async with self._lock:
            await self._repeated(call, once)

    async def _clear(self, call: Call, outstation: int) -> None:
        """Clear the indication of a restart. What was asked for has succeeded before, so a failure is left to the next connection."""
        self._cleared.add(outstation)
        with suppress(AdapterError, Lost):
            await self._send(call, outstation, FunctionCode.WRITE, _CLEAR_RESTART, changes_state=False)

    # -- the connection ---------------------------------------------------------------------------------------

    async def _repeated(self, call: Call, exchange: Callable[[], Awaitable[T]]) -> T:
        try:
            try:
                return await exchange()
            except Lost:
                if call.sent:
                    raise
                return await exchange()
        except Lost:
            raise AdapterError("connection_lost", "the connection broke during the call") from None

    async def _guarded(self, call: Call, exchange: Awaitable[T]) -> T:
        """Wait for an answer; after any failure the connection is ended, so that nothing late is taken for another answer."""
        try:
            answer = await exchange
        except (Lost, OSError, TimeoutError, BadReply, asyncio.CancelledError) as error:
            self._drop()
            call.disconnected()
            if isinstance(error, TimeoutError):
                message = f"the outstation did not answer within {self._timeout_s:g} s"
                raise AdapterError("timeout", message) from None
            if isinstance(error, BadReply):
                message = f"the answer is not the one to the request: {error}"
                raise AdapterError("protocol_error", message) from None
            if isinstance(error, OSError):
                raise AdapterError("connection_lost", "the connection broke within the answer") from None
            raise
        call.answered()
        return answer

    async def _connected(self, call: Call) -> Connection:
        existing = self._connection
        if existing is not None and existing.is_open:
            call.connection(generation=self._generation, fresh=False)
            return existing
        self._drop()
        call.disconnected()
        await resolve(self._host, self._port)
        connection = Connection(self._master, self._known, self._keep)
        try:
            async with asyncio.timeout(self._timeout_s):
                await asyncio.get_running_loop().create_connection(lambda: connection, self._host, self._port)
        except (OSError, TimeoutError):
            message = f"no connection to {self._host}:{self._port}; is the outstation on, and is the address right?"
            raise AdapterError("connect_failed", message, outcome="not_sent") from None
        self._connection = connection
        self._cleared.clear()
        self._generation += 1
        call.connection(generation=self._generation, fresh=True)
        return connection

    def _drop(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.abort()

    async def close(self) -> None:
        """Close the connection."""
        self._drop()


def _nothing_to_check(response: Response) -> None:
    """Accept every answer that is no refusal."""
