"""The fault plan of the controller: which request gets which fault."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..fault_plan import Plan
from ..fault_rules import FLAG, SKIP, TEXT, Table, hexadecimal, integer, one_of
from ..framed_connection import ANSWER_FAULTS, AnswerRule

__all__ = ["TABLE", "FaultPlan", "Rule"]

_CONNECTING = ("register", "forward_open", "forward_close")
TABLE = Table(
    conditions={
        "service": one_of(
            *_CONNECTING,
            *(
                "list_identity",
                "read",
                "write",
                "modify",
                "tag_list",
                "template",
                "identity",
                "clock",
                "set_clock",
                "multiple",
            ),
            "other",
        ),
        "tag": TEXT,
        "skip": SKIP,
    },
    actions={
        "status": integer(1, 0xFF),
        "extended": integer(0, 0xFFFF),
        "encapsulation": integer(1, 0xFFFF),
        "ack_only": FLAG,
        "sequence": integer(-0xFFFF, 0xFFFF),
        "context": integer(0, 0xFF),
        "connection": integer(-0xFFFF, 0xFFFF),
        "answer_service": integer(0, 0xFF),
        "answer_type": integer(0, 0xFFFF),
        "answer_data": hexadecimal(400),
        "length": integer(-1000, 1000),
        **ANSWER_FAULTS,
    },
    example="{'drop': true}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule(AnswerRule):
    """One rule: conditions (None matches everything), how often it applies, and what happens beside what :class:`AnswerRule` has.

    Attributes:
        service: what is asked for, by the request or by one of the services that it holds.
        tag: name of the tag that this service is for, without its program's if it is not the program's.
        status, extended: not executed; general status, and the word that follows, of the services that fit.
        encapsulation: not executed; status of the encapsulation header, without data.
        ack_only: acknowledge a write without doing it.
        sequence: added to the sequence count of a connected answer.
        context: the first byte of the sender context is changed in these bits.
        connection: added to the connection id of a connected answer.
        answer_service: service code of the answer.
        answer_type, answer_data: type code and bytes with which a read is answered.
        length: added to the length of the encapsulation header; the bytes stay.
    """

    service: str | None = None
    tag: str | None = None
    status: int | None = None
    extended: int | None = None
    encapsulation: int | None = None
    ack_only: bool = False
    sequence: int = 0
    context: int = 0
    connection: int = 0
    answer_service: int | None = None
    answer_type: int | None = None
    answer_data: bytes | None = None
    length: int = 0

    def fits(self, item: Mapping[str, Any], tag: str | None) -> bool:
        """Tell whether a service is one that the rule is about.

        Args:
            item: as the journal has it.
            tag: name of the tag that it is for.
        """
        # Connecting is spared by a rule that does not name it.
        named = self.service == item["asks"] or (self.service is None and item["asks"] not in _CONNECTING)
        return named and self.tag in (None, tag)


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make."""

    table, rule = TABLE, Rule

    def match(self, asked: list[tuple[Mapping[str, Any], str | None]]) -> Rule | None:
        """Return the rule that applies to a request with these services and tags, if any; count it."""
        return self.first(lambda rule: any(rule.fits(item, tag) for item, tag in asked))
