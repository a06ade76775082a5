"""The fault plan of the OPC UA server: which service call gets which fault."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from asyncua import ua

from ..fault_plan import FaultRule, Plan
from ..fault_rules import FLAG, SKIP, TEXT, Field, Table, number
from ..network import MANNERS

__all__ = ["NOTHING", "TABLE", "FaultPlan", "Rule"]

_SYMBOL = Field(
    accepts=lambda value: isinstance(value, str) and isinstance(getattr(ua.StatusCodes, value, None), int),
    expected="the symbol of a status code",
)
TABLE = Table(
    conditions={"service": TEXT, "node": TEXT, "skip": SKIP},
    actions={
        "status": _SYMBOL,
        "with_status": _SYMBOL,
        "service_fault": _SYMBOL,
        "delay_s": number(0, 600),
        "ack_only": FLAG,
        "clamp": number(),
        "refuse_timestamps": FLAG,
        "refuse_status": FLAG,
        "drop": FLAG,
        "close": FLAG,
        "reset": FLAG,
        **MANNERS,
    },
    example="{'status': 'BadDeviceFailure'}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule(FaultRule):
    """One rule: conditions (None matches everything), how often it applies, and what happens beside what :class:`FaultRule` has.

    Attributes:
        service: name of the service as in the journal, for instance ``Read``.
        node: node id that the request must name among others.
        status: every item is answered with this status code, by symbol, and not executed.
        with_status: a Read, Write or Call is executed, and what is Good is answered with this status code instead, such as
            ``GoodCompletesAsynchronously`` or ``UncertainSensorNotAccurate``.
        service_fault: the whole call is answered with a ServiceFault of this symbol and not executed.
        delay_s: it is executed this many seconds later; later requests are not delayed by it.
        ack_only: a write is acknowledged with Good, and not done.
        clamp: the number that a write stores instead, acknowledged with GoodClamped.
        refuse_timestamps, refuse_status: a Write of a value with a timestamp, or with a status code other than Good, is refused
            with BadWriteNotSupported (OPC 10000-4, 5.11.4); other writes are executed.
        drop: executed, but not answered.
        close, reset: executed; then the connection is closed, or reset, without an answer.
    """

    service: str | None = None
    node: str | None = None
    status: str | None = None
    with_status: str | None = None
    service_fault: str | None = None
    delay_s: float = 0.0
    ack_only: bool = False
    clamp: float | None = None
    refuse_timestamps: bool = False
    refuse_status: bool = False
    drop: bool = False
    close: bool = False
    reset: bool = False


NOTHING = Rule()
"""The rule for a call that no rule matches."""


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make."""

    table, rule = TABLE, Rule

    def match(self, service: str, nodes: Sequence[str]) -> Rule:
        """Return the rule that applies to this call, or :data:`NOTHING`; count it."""
        found = self.first(lambda rule: rule.service in (None, service) and (rule.node is None or rule.node in nodes))
        return NOTHING if found is None else found
