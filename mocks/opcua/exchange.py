"""One service call on its way through the server: its entries in the journal, and the fault that applies to it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextvars import ContextVar
from typing import Any

from asyncua import ua

from pytest_otmcp.wire.framing import Framer
from pytest_otmcp.wire.opcua import chunk_length

from .faults import NOTHING, Rule
from .state import DeviceState

__all__ = ["Exchange", "current"]

_current: ContextVar[Exchange] = ContextVar("exchange")


def current() -> Exchange:
    """Return the service call that the running code belongs to."""
    return _current.get()


class Exchange:
    """One service call, from its request to its answer.

    Args:
        chunks: of the request; taken out when they are recorded.

    Attributes:
        service: its name, OPC 10000-4.
        connection: its number.
        request_id: with which its answer is sent.
        rule: the fault that was applied.
        said: of the answer beside its bytes, for the journal.
    """

    def __init__(
        self, device: DeviceState, connection: int, service: str, request_id: int, chunks: list[bytes]
    ) -> None:
        self.service = service
        self.request_id = request_id
        self.rule: Rule = NOTHING
        self.said: dict[str, Any] = {}
        self._device = device
        self.connection = connection
        self._chunks = chunks
        self._asked: int | None = None
        _current.set(self)

    def asked(self, about: Sequence[str] | None = None) -> None:
        """Record the request, the first time that this is called, and find the fault that applies to it.

        Args:
            about: node ids that the request names; None for a request to which no fault applies.
        """
        if self._asked is not None or not self._chunks:
            return
        if about is not None:
            self.rule = self._device.faults.match(self.service, about)
        said: dict[str, Any] = {} if self.rule is NOTHING else {"fault": self.rule.action}
        for chunk in self._chunks:
            self._asked = self._device.journal.frame(chunk, connection=self.connection, direction="in", **said)
        self._chunks.clear()

    async def suffer(self) -> Rule:
        """Apply the fault to this call before it is executed, and return the rule.

        Raises:
            UaStatusCodeError: the call is to be answered with this ServiceFault; or, half open, not executed and not answered.
        """
        rule = self.rule
        if rule.manner.half_open:
            raise ua.UaStatusCodeError(ua.StatusCodes.BadShutdown)
        if rule.delay_s:
            await asyncio.sleep(rule.delay_s)
        if rule.service_fault is not None:
            raise ua.UaStatusCodeError(getattr(ua.StatusCodes, rule.service_fault))
        return rule

    def answered(self, message: bytes, request_id: int, **said: Any) -> None:
        """Record an answer.

        Args:
            message: its chunks, one after the other.
            request_id: with which it is sent: the library may answer an earlier call while it handles this one.
            said: of it beside its bytes.
        """
        self.asked()
        own = request_id == self.request_id
        for chunk in Framer(chunk_length).feed(message):
            self._device.journal.frame(
                chunk,
                connection=self.connection,
                direction="out",
                answers=self._asked if own else None,
                **(self.said if own else {}),
                **said,
            )
