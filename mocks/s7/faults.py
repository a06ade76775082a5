"""The fault plan of the S7 controller: which request gets which fault."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..fault_plan import Plan
from ..fault_rules import FLAG, SKIP, Table, hexadecimal, integer, one_of
from ..framed_connection import ANSWER_FAULTS, AnswerRule

__all__ = ["TABLE", "FaultPlan", "Rule"]

TABLE = Table(
    conditions={
        "service": one_of("setup", "read", "write", "control", "stop", "szl", "clock", "set_clock", "other"),
        "db": integer(0, 0xFFFF),
        "byte": integer(0, 0xFFFF),
        "skip": SKIP,
    },
    actions={
        "error": integer(1, 0xFFFF),
        "return_code": integer(0, 0xFE),
        "ack_only": FLAG,
        "reference": integer(-0xFFFF, 0xFFFF),
        "answer_reference": integer(0, 0xFFFF),
        "answer_function": integer(0, 0xFF),
        "answer_count": integer(0, 0xFF),
        "answer_data": hexadecimal(400),
        "data_length": integer(-4000, 4000),
        "length": integer(-1000, 1000),
        **ANSWER_FAULTS,
    },
    example="{'drop': true}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule(AnswerRule):
    """One rule: conditions (None matches everything), how often it applies, and what happens beside what :class:`AnswerRule` has.

    Attributes:
        service: what the request asks for; ``db`` and ``byte`` are those of its first variable.
        error: not executed; class and code of the answer's header, or the error of user data.
        return_code: not executed; the code of every variable, or of user data.
        ack_only: acknowledge a write or a control without doing it.
        reference: added to the PDU reference of the answer.
        answer_reference: PDU reference of the answer.
        answer_function, answer_count: of the answer's parameters.
        answer_data: bytes that a successful read answers with for each variable, however many were asked for; also for user data.
        data_length: added to the length of each variable that a read answers with; its bytes stay.
        length: added to the length of the TPKT; the bytes stay.
    """

    service: str | None = None
    db: int | None = None
    byte: int | None = None
    error: int | None = None
    return_code: int | None = None
    ack_only: bool = False
    reference: int = 0
    answer_reference: int | None = None
    answer_function: int | None = None
    answer_count: int | None = None
    answer_data: bytes | None = None
    data_length: int = 0
    length: int = 0


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make."""

    table, rule = TABLE, Rule

    def match(self, request: Mapping[str, Any]) -> Rule | None:
        """Return the rule that applies to this request, if any; count it."""
        first: Mapping[str, Any] = next(iter(request.get("items", ())), {})
        return self.first(
            # The agreement on a PDU belongs to connecting: only a rule that names it is about it.
            lambda rule: (
                (rule.service == request["service"] or (rule.service is None and request["service"] != "setup"))
                and rule.db in (None, first.get("db"))
                and rule.byte in (None, first.get("byte"))
            )
        )
