"""The fault plan of the EtherCAT segment: which request gets which fault."""

from __future__ import annotations

from dataclasses import dataclass

from pytest_otmcp.wire.ethercat import SERVICES

from ..fault_plan import FaultRule, Plan
from ..fault_rules import FLAG, SKIP, Table, hexadecimal, integer, number, one_of
from ..network import MANNERS

__all__ = ["TABLE", "FaultPlan", "Rule"]

TABLE = Table(
    conditions={"service": one_of(*SERVICES), "slave": integer(0, 1), "changes": FLAG, "skip": SKIP},
    actions={
        "abort": integer(1, 0xFFFFFFFF),
        "delay_s": number(0, 3600),
        "drop": FLAG,
        "lose": FLAG,
        "ack_only": FLAG,
        "answer_index": integer(0, 0xFFFF),
        "answer_data": hexadecimal(64),
        "counter": integer(0, 0xFFFF),
        "mangle": MANNERS["mangle"],
    },
    example="{'drop': true}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule(FaultRule):
    """One rule: conditions (None matches everything), how often it applies, and what happens beside what :class:`FaultRule` has.

    Attributes:
        service: what the request asks for.
        slave: position of the slave that is asked.
        changes: True for what changes an object or outputs, False for every other request.
        abort: an SDO is not executed; the answer has this abort code.
        delay_s: the answer of an object, or the frame, comes this many seconds later.
        drop: execute, but do not answer: no answer gets into the mailbox, other frames do not come back.
        lose: neither execute nor answer.
        ack_only: answer as if it were done, without doing it.
        answer_index: index of the object in the answer to an SDO.
        answer_data: value in the answer to an SDO.
        counter: working counter of the frame that comes back.
    """

    service: str | None = None
    slave: int | None = None
    changes: bool | None = None
    abort: int | None = None
    delay_s: float = 0.0
    drop: bool = False
    lose: bool = False
    ack_only: bool = False
    answer_index: int | None = None
    answer_data: bytes | None = None
    counter: int | None = None


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make."""

    table, rule = TABLE, Rule

    def match(self, service: str, slave: int | None, *, changes: bool) -> Rule | None:
        """Return the rule that applies to a request, if any; count it."""
        return self.first(
            lambda rule: (
                rule.service in (None, service) and rule.slave in (None, slave) and rule.changes in (None, changes)
            )
        )
