"""The fault plan of the PROFIBUS segment: which request gets which fault."""

from __future__ import annotations

from dataclasses import dataclass

from pytest_otmcp.wire.profibus import SERVICES

from ..fault_plan import FaultRule, Plan
from ..fault_rules import FLAG, SKIP, Table, hexadecimal, integer, number, one_of
from ..network import MANNERS

__all__ = ["TABLE", "FaultPlan", "Rule"]

_STATION = integer(0, 127)
TABLE = Table(
    conditions={"service": one_of(*SERVICES), "station": _STATION, "changes": FLAG, "skip": SKIP},
    actions={
        "error": integer(1, 15),
        "delay_s": number(0, 3600),
        "drop": FLAG,
        "lose": FLAG,
        "garbage": FLAG,
        "truncate": integer(0, 255),
        "ack_only": FLAG,
        "answer_station": _STATION,
        "answer_master": _STATION,
        "answer_data": hexadecimal(244),
        "drip_s": MANNERS["drip_s"],
        "duplicate": MANNERS["duplicate"],
        "mangle": MANNERS["mangle"],
    },
    example="{'drop': true}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule(FaultRule):
    """One rule: conditions (None matches everything), how often it applies, and what happens beside what :class:`FaultRule` has.

    Attributes:
        service: what the request asks for.
        station: that is asked.
        changes: True for a Data_Exchange with other outputs than the slave holds, False for every other request.
        error: not executed; the answer has no data and this function: 1 UE, 2 RR, 3 RS, 9 NR.
        delay_s: answer this many seconds later; later requests are not delayed by it.
        drop: execute, but do not answer.
        lose: neither execute nor answer.
        garbage: execute, answer with bytes that are no telegram.
        truncate: send only this many bytes of the answer.
        ack_only: answer as if it were done, without doing it.
        answer_station, answer_master: source and destination address of the answer.
        answer_data: bytes that an answer with data has.
    """

    service: str | None = None
    station: int | None = None
    changes: bool | None = None
    error: int | None = None
    delay_s: float = 0.0
    drop: bool = False
    lose: bool = False
    garbage: bool = False
    truncate: int | None = None
    ack_only: bool = False
    answer_station: int | None = None
    answer_master: int | None = None
    answer_data: bytes | None = None


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make."""

    table, rule = TABLE, Rule

    def match(self, service: str, station: int, *, changes: bool) -> Rule | None:
        """Return the rule that applies to a request, if any; count it."""
        return self.first(
            lambda rule: (
                rule.service in (None, service) and rule.station in (None, station) and rule.changes in (None, changes)
            )
        )
