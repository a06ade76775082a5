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

    def asked(self, **facts: Any) -> None:
        """Record the request, the first time that this is called."""
        if self._asked is None:
            self._asked = self._device.journal.append(
                connection=self._connection,
                direction="in",
                kind=self.service,
                request=self.service not in SESSION_KEEPING,
                state_changing=self.service in STATE_CHANGING,
                **facts,
            )

    async def suffer(self, nodes: Sequence[str] = ()) -> Rule:
        """Apply the fault plan to this call and return the rule.

        Raises:
            UaStatusCodeError: the call is to be answered with this ServiceFault.
        """
        self.rule = rule = self._device.faults.match(self.service, nodes)
        if rule.delay_s:
            await asyncio.sleep(rule.delay_s)
        if rule.service_fault is not None:
            raise ua.UaStatusCodeError(getattr(ua.StatusCodes, rule.service_fault))
        return rule

    def answered(self, result: ua.StatusCode) -> None:
        """Record the answer."""
        self.asked()
        self._device.journal.append(
            connection=self._connection,
            direction="out",
            kind=self.service,
            answers=self._asked,
            service_result=result.name,
            **self.answer,
        )
