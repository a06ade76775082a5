"""The fault plan of the Modbus device: which request gets which fault."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..fault_plan import Plan
from ..fault_rules import FLAG, SKIP, Field, Table, integer
from ..framed_connection import ANSWER_FAULTS, AnswerRule

__all__ = ["TABLE", "FaultPlan", "Rule"]

_REGISTER = integer(0, 0xFFFF)
_ECHOES = ("value", "address", "count")
TABLE = Table(
    conditions={"function": integer(0, 0xFF), "address": integer(0, 0xFFFF), "unit": integer(0, 0xFF), "skip": SKIP},
    actions={
        "exception": integer(0, 0xFF),
        "transaction_id": integer(-0xFFFF, 0xFFFF),
        "answer_transaction": integer(0, 0xFFFF),
        "answer_unit": integer(0, 0xFF),
        "answer_function": integer(0, 0xFF),
        "protocol_id": integer(0, 0xFFFF),
        "length": integer(-260, 260),
        "byte_count": integer(-255, 255),
        "echo": Field(
            accepts=lambda value: (
                isinstance(value, dict)
                and bool(value)
                and value.keys() <= set(_ECHOES)
                and all(map(_REGISTER.accepts, value.values()))
            ),
            expected=f"an object with {', '.join(_ECHOES)}, each an integer from 0 to 65535",
        ),
        "clamp": Field(
            accepts=lambda value: (
                isinstance(value, list)
                and len(value) == 2
                and all(map(_REGISTER.accepts, value))
                and value[0] <= value[1]
            ),
            expected="a list of two integers from 0 to 65535, the lower one first",
            convert=tuple,
        ),
        "ack_only": FLAG,
        "answer_values": Field(
            accepts=lambda value: isinstance(value, list) and len(value) <= 125 and all(map(_REGISTER.accepts, value)),
            expected="a list of at most 125 integers from 0 to 65535",
            convert=tuple,
        ),
        **ANSWER_FAULTS,
    },
    example="{'drop': true}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule(AnswerRule):
    """One rule: conditions (None matches everything), how often it applies, and what happens beside what :class:`AnswerRule` has.

    Attributes:
        exception: answer with this exception code; the request is not executed.
        transaction_id: added to the transaction identifier of the answer.
        answer_transaction: transaction identifier of the answer.
        answer_unit: unit identifier of the answer.
        answer_function: function code of the answer, with the bit that marks an exception.
        protocol_id: protocol identifier of the answer, which is 0 in Modbus.
        length: added to the length field of the answer; its bytes stay.
        byte_count: added to the byte count of the answer to a read; its data stays.
        echo: what the answer to a write names instead of what was written: ``value`` (functions 5 and 6), ``count`` (15 and 16),
            ``address``.
        clamp: registers that functions 6, 16 and 22 write are stored not lower and not higher than these two numbers; the answer
            echoes the request.
        ack_only: acknowledge a write without doing it.
        answer_values: registers or bits that a successful read answers with, however many were asked for.
    """

    function: int | None = None
    address: int | None = None
    unit: int | None = None
    exception: int | None = None
    transaction_id: int = 0
    answer_transaction: int | None = None
    answer_unit: int | None = None
    answer_function: int | None = None
    protocol_id: int = 0
    length: int = 0
    byte_count: int = 0
    echo: Mapping[str, int] = field(default_factory=dict)
    clamp: tuple[int, int] | None = None
    ack_only: bool = False
    answer_values: tuple[int, ...] | None = None


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make."""

    table, rule = TABLE, Rule

    def match(self, unit: int, request: Mapping[str, Any]) -> Rule | None:
        """Return the rule that applies to this request, if any; count it."""
        return self.first(
            lambda rule: (
                rule.function in (None, request["function"])
                and rule.address in (None, request.get("address"))
                and rule.unit in (None, unit)
            )
        )
