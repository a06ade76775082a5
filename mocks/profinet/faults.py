"""The fault plan of the PROFINET device: which request gets which fault."""

from __future__ import annotations

from dataclasses import dataclass

from pytest_otmcp.wire.profinet.services import SERVICES

from ..fault_plan import FaultRule, Plan
from ..fault_rules import FLAG, SKIP, Table, hexadecimal, integer, number, one_of
from ..network import MANNERS

__all__ = ["TABLE", "FaultPlan", "Rule"]

_WORD = integer(0, 0xFFFF)
TABLE = Table(
    conditions={"service": one_of(*SERVICES), "slot": _WORD, "index": _WORD, "changes": FLAG, "skip": SKIP},
    actions={
        "error": integer(1, 255),
        "delay_s": number(0, 3600),
        "drop": FLAG,
        "lose": FLAG,
        "garbage": FLAG,
        "truncate": _WORD,
        "ack_only": FLAG,
        "answer_sequence": _WORD,
        "answer_slot": _WORD,
        "answer_data": hexadecimal(1024),
        "duplicate": MANNERS["duplicate"],
        "mangle": MANNERS["mangle"],
    },
    example="{'drop': true}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule(FaultRule):
    """One rule: conditions (None matches everything), how often it applies, and what happens beside what :class:`FaultRule` has.

    Attributes:
        service: what is asked for. ``inputs`` are the cyclic frames of the device, which ask for nothing: they can be dropped.
        slot, index: of a record that is read or written.
        changes: True for what may change the plant, False for every other request.
        error: not executed; the answer says this error (code 1 of a PNIO status; the result of a block of DCP).
        delay_s: answer this many seconds later; later requests are not delayed by it.
        drop: execute, but do not answer.
        lose: neither execute nor answer.
        garbage: execute, answer with bytes that are no answer.
        truncate: send only this many bytes of the answer's frame.
        ack_only: answer as if it were done, without doing it.
        answer_sequence: what is added to the number of the call in the answer, or to the transaction of DCP.
        answer_slot: the slot that the answer names.
        answer_data: content of a record that is read.
    """

    service: str | None = None
    slot: int | None = None
    index: int | None = None
    changes: bool | None = None
    error: int | None = None
    delay_s: float = 0.0
    drop: bool = False
    lose: bool = False
    garbage: bool = False
    truncate: int | None = None
    ack_only: bool = False
    answer_sequence: int = 0
    answer_slot: int | None = None
    answer_data: bytes | None = None


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make."""

    table, rule = TABLE, Rule

    def match(
        self, service: str, *, slot: int | None = None, index: int | None = None, changes: bool = False
    ) -> Rule | None:
        """Return the rule that applies to a request, if any; count it."""
        return self.first(
            lambda rule: (
                rule.service in (None, service)
                and rule.slot in (None, slot)
                and rule.index in (None, index)
                and rule.changes in (None, changes)
            )
        )
