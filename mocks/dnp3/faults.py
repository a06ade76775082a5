"""The fault plan of the outstation: which request gets which fault."""

from __future__ import annotations

from dataclasses import dataclass

from pytest_otmcp.wire.dnp3.application import Request

from ..fault_plan import Plan
from ..fault_rules import FLAG, SKIP, Table, hexadecimal, integer
from ..framed_connection import ANSWER_FAULTS, AnswerRule

__all__ = ["TABLE", "FaultPlan", "Rule"]

TABLE = Table(
    conditions={
        "function": integer(1, 127),
        "group": integer(0, 0xFF),
        "index": integer(0, 0xFFFF),
        "skip": SKIP,
    },
    actions={
        "iin": integer(0, 0xFFFF),
        "with_iin": integer(0, 0xFFFF),
        "status": integer(1, 0x7F),
        "ack_only": FLAG,
        "sequence": integer(-15, 15),
        "answer_index": integer(-0xFF, 0xFF),
        "answer_source": integer(0, 0xFFFF),
        "answer_objects": hexadecimal(1000),
        "length": integer(-255, 255),
        "unsolicited": FLAG,
        **ANSWER_FAULTS,
    },
    example="{'drop': true}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule(AnswerRule):
    """One rule: conditions (None matches everything), how often it applies, and what happens beside what :class:`AnswerRule` has.

    Attributes:
        function: function code of the request.
        group, index: of an object that it names.
        iin: not executed; answered without objects and with these internal indications beside the outstation's own.
        with_iin: executed, answered with these internal indications as well.
        status: nothing is selected or operated, and each point of the answer has this status.
        ack_only: acknowledge a write or an operation without doing it.
        sequence: added to the application sequence number of the answer.
        answer_index: added to the indexes of the answer's first object header.
        answer_source: link address that the answer comes from.
        answer_objects: objects of the answer.
        length: added to the length of the link frame; the bytes stay.
        unsolicited: an unsolicited response with the events of class 1, if there are some, comes before the answer.
    """

    function: int | None = None
    group: int | None = None
    index: int | None = None
    iin: int | None = None
    with_iin: int = 0
    status: int | None = None
    ack_only: bool = False
    sequence: int = 0
    answer_index: int = 0
    answer_source: int | None = None
    answer_objects: bytes | None = None
    length: int = 0
    unsolicited: bool = False


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make."""

    table, rule = TABLE, Rule

    def match(self, request: Request | None) -> Rule | None:
        """Return the rule that applies to this request, if any; count it. None is a request of the link layer, which only rules without
        a condition are about."""
        return self.first(
            lambda rule: (
                rule.function is rule.group is rule.index is None
                if request is None
                else rule.function in (None, request.function) and request.concerns(rule.group, rule.index)
            )
        )
