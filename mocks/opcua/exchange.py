"""One service call on its way through the server: its entries in the journal, and the fault that applies to it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextvars import ContextVar
from typing import Any

from asyncua import ua

from .faults import NOTHING, Rule
from .state import DeviceState

__all__ = ["SESSION_KEEPING", "STATE_CHANGING", "Exchange", "current"]

STATE_CHANGING = frozenset(
    {"Write", "Call", "HistoryUpdate", "AddNodes", "AddReferences", "DeleteNodes", "DeleteReferences"}
)
SESSION_KEEPING = frozenset(
    {"OpenSecureChannel", "CloseSecureChannel", "FindServers", "GetEndpoints"}
    | {"CreateSession", "ActivateSession", "CloseSession", "CreateSubscription", "Publish", "DeleteSubscriptions"}
)
"""Services that open, keep and close sessions and subscriptions: they do not ask the plant for anything."""

_current: ContextVar[Exchange] = ContextVar("exchange")


def current() -> Exchange:
    """Return the service call that the running code belongs to."""
    return _current.get()


class Exchange:
    """One service call, from its request to its answer.

    Attributes:
        service: its name, OPC 10000-4.
        rule: the fault that was applied.
        answer: facts of the answer, for the journal.
    """

    def __init__(self, device: DeviceState, connection: int, service: str, handle: int) -> None:
        self.service = service
        self.handle = handle
        self.rule: Rule = NOTHING
        self.answer: dict[str, Any] = {}
        self._device = device
        self._connection = connection
        self._asked: int | None = None
        _current.set(self)

    def asked(self, about: Sequence[str] | None = None, **facts: Any) -> None:
        """Record the request, the first time that this is called, and find the fault that applies to it.

        Args:
            about: node ids that the request names; None for a request to which no fault applies.
            facts: what the journal has of it.
        """
        if self._asked is not None:
            return
        if about is not None:
            self.rule = self._device.faults.match(self.service, about)
        if self.rule is not NOTHING:
            facts["fault"] = self.rule.action
        self._asked = self._device.journal.event(
            connection=self._connection,
            direction="in",
            kind=self.service,
            request=self.service not in SESSION_KEEPING,
            state_changing=self.service in STATE_CHANGING,
            **facts,
        )

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

    def answered(self, result: ua.StatusCode, **facts: Any) -> None:
        """Record the answer; ``facts`` are those of its way."""
        self.asked()
        self._device.journal.event(
            connection=self._connection,
            direction="out",
            kind=self.service,
            answers=self._asked,
            service_result=result.name,
            **self.answer,
            **facts,
        )
