"""The fault plan of the OPC UA server: which service call gets which fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from asyncua import ua

from ..fault_rules import FLAG, TEXT, Field, Plan, Table, number

__all__ = ["NOTHING", "FaultPlan", "Rule"]

_SYMBOL = Field(
    accepts=lambda value: isinstance(value, str) and isinstance(getattr(ua.StatusCodes, value, None), int),
    expected="the symbol of a status code",
)
_TABLE = Table(
    conditions={"service": TEXT, "node": TEXT},
    actions={
        "status": _SYMBOL,
        "service_fault": _SYMBOL,
        "delay_s": number(0, 600),
        "ack_only": FLAG,
        "clamp": number(),
        "drop": FLAG,
        "close": FLAG,
        "reset": FLAG,
    },
    example="{'status': 'BadDeviceFailure'}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One rule: conditions (None matches everything), how often it applies, and what happens.

    Attributes:
        service: name of the service as in the journal, for instance ``Read``.
        node: node id that the request must name among others.
        times: applied at most this often, None without limit.
        status: every item is answered with this status code, by symbol, and not executed.
        service_fault: the whole call is answered with a ServiceFault of this symbol and not executed.
        delay_s: it is executed this many seconds later; later requests are not delayed by it.
        ack_only: a write is acknowledged with Good, and not done.
        clamp: the number that a write stores instead, acknowledged with GoodClamped.
        drop: executed, but not answered.
        close, reset: executed; then the connection is closed, or reset, without an answer.
    """

    service: str | None = None
    node: str | None = None
    times: int | None = None
    status: str | None = None
    service_fault: str | None = None
    delay_s: float = 0.0
    ack_only: bool = False
    clamp: float | None = None
    drop: bool = False
    close: bool = False
    reset: bool = False


NOTHING = Rule()
"""The rule for a call that no rule matches."""


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make.

    Raises:
        ValueError: a rule is not understood.
    """

    def __init__(self, rules: list[dict[str, Any]]) -> None:
        super().__init__([Rule(**_TABLE.read(rule)) for rule in rules])

    def match(self, service: str, nodes: Sequence[str]) -> Rule:
        """Return the rule that applies to this call, or :data:`NOTHING`; count it."""
        found = self.first(lambda rule: rule.service in (None, service) and (rule.node is None or rule.node in nodes))
        return NOTHING if found is None else found
