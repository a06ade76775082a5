"""The connection to the outstations, and the events that they tell unasked."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Callable, Sequence
from contextlib import suppress

from dnp3.core.enums import FunctionCode
from dnp3.core.flags import IIN

from ..core import AdapterError, Call, DeviceLink
from .connection import Connection, Response
from .objects import Point
from .refusals import refused

__all__ = ["Link"]

_SEQUENCES = 16
_MOST_KEPT = 1000
"""Events per outstation that wait for somebody who polls."""
_CLEAR_RESTART = bytes([80, 1, 0, 7, 7, 0])
"""Internal indications (g80v1), index 7 to 7: zero."""

Check = Callable[[Response], None]
Step = tuple[int, bytes]
"""A function code and the objects of a request."""


class Link(DeviceLink[Connection]):
    """One connection at a time.

    Args:
        host, port: of the outstation or its gateway.
        master: own link address.
        timeout_s: seconds for connecting, and for each fragment of an answer.
        known: link addresses of the outstations that may send events unasked.
        clears_restart: the indication that an outstation has restarted is cleared when it has been seen.
        tls: as of :class:`~..core.DeviceLink`.
    """

    peer = "outstation"

    def __init__(
        self,
        host: str,
        port: int,
        master: int,
        timeout_s: float,
        *,
        known: set[int],
        clears_restart: bool,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        super().__init__(host, port, timeout_s, tls)
        self._master = master
        self._known = known
        self._clears_restart = clears_restart
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
        async def all_steps(connection: Connection) -> Response:
            for function, objects in steps:
                response = await self._step(connection, call, outstation, function, objects, changes_state)
                check(response)
            return response

        response = await self.perform(call, all_steps)
        if response.indications & IIN.DEVICE_RESTART and outstation not in self._cleared and self._clears_restart:
            await self._clear(call, outstation)
        return response

    async def _step(
        self, connection: Connection, call: Call, outstation: int, function: int, objects: bytes, changes_state: bool
    ) -> Response:
        response = await self._send(connection, call, outstation, function, objects, changes_state)
        call.answered()
        call.trace["iin"] = response.indications
        call.trace["indications"] = [bit.name for bit in IIN if bit & response.indications]
        if (error := refused(call, response.indications)) is not None:
            raise error
        return response

    async def _send(
        self, connection: Connection, call: Call, outstation: int, function: int, objects: bytes, changes_state: bool
    ) -> Response:
        sequence = self._sequences[outstation] = (self._sequences.get(outstation, -1) + 1) % _SEQUENCES
        call.sending(changes_state=changes_state)
        call.trace["outstation"] = outstation
        call.trace.setdefault("functions", []).append(int(function))
        call.trace.setdefault("sequences", []).append(sequence)
        return await connection.ask(outstation, sequence, function, objects, self._timeout_s)

    async def status(self, call: Call, outstation: int) -> None:
        """Ask the data link layer of an outstation whether it is there.

        Raises:
            AdapterError: no connection, or no answer.
        """

        async def ask(connection: Connection) -> None:
            call.trace["outstation"] = outstation
            call.sending(changes_state=False)
            await connection.ask_link_status(outstation, self._timeout_s)

        await self.perform(call, ask)

    async def _clear(self, call: Call, outstation: int) -> None:
        """Clear the indication of a restart. What was asked for has succeeded before, so a failure is left to the next connection."""
        self._cleared.add(outstation)

        async def clear(connection: Connection) -> None:
            await self._send(connection, call, outstation, FunctionCode.WRITE, _CLEAR_RESTART, changes_state=False)

        with suppress(AdapterError):
            await self.perform(call, clear)

    # -- the connection ---------------------------------------------------------------------------------------

    def _explained(self, call: Call, connection: Connection, error: Exception) -> Exception:
        if isinstance(error, OSError) and not isinstance(error, TimeoutError):
            return AdapterError("connection_lost", "the connection broke within the answer")
        return super()._explained(call, connection, error)

    async def _open(self) -> Connection:
        connection = Connection(self._master, self._known, self._keep)
        await asyncio.get_running_loop().create_connection(lambda: connection, self._host, self._port, **self._security)
        self._cleared.clear()
        return connection

    def _is_usable(self, connection: Connection) -> bool:
        return connection.is_open

    def _end(self, connection: Connection) -> None:
        connection.abort()


def _nothing_to_check(response: Response) -> None:
    """Accept every answer that is no refusal."""
