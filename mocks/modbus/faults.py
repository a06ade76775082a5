"""The fault plan of the Modbus device: which request gets which fault."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..fault_rules import FLAG, Field, Plan, Table, integer, number

__all__ = ["FaultPlan", "Rule"]

_REGISTER = integer(0, 0xFFFF)
_TABLE = Table(
    conditions={"function": integer(0, 0xFF), "address": integer(0, 0xFFFF), "unit": integer(0, 0xFF)},
    actions={
        "exception": integer(0, 0xFF),
        "delay_s": number(0, 3600),
        "drop": FLAG,
        "garbage": FLAG,
        "transaction_id": integer(-0xFFFF, 0xFFFF),
        "answer_unit": integer(0, 0xFF),
        "truncate": integer(0, 260),
        "close": FLAG,
        "reset": FLAG,
        "ack_only": FLAG,
        "answer_values": Field(
            accepts=lambda value: isinstance(value, list) and len(value) <= 125 and all(map(_REGISTER.accepts, value)),
            expected="a list of at most 125 integers from 0 to 65535",
        ),
    },
    example="{'drop': true}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One rule: conditions (None matches everything), how often it applies, and what happens.

    Attributes:
        times: applied at most this often, None without limit.
        exception: answer with this exception code; the request is not executed.
        delay_s: answer this many seconds later; later requests are not delayed by it.
        drop: execute, but do not answer.
        garbage: execute, answer with bytes that are no MBAP frame.
        transaction_id: added to the transaction identifier of the answer.
        answer_unit: unit identifier of the answer.
        truncate: send only this many bytes of the answer.
        close, reset: execute, then close the connection, or reset it.
        ack_only: acknowledge a write without doing it.
        answer_values: registers or bits that a successful read answers with, however many were asked for.
    """

    function: int | None = None
    address: int | None = None
    unit: int | None = None
    times: int | None = None
    exception: int | None = None
    delay_s: float = 0.0
    drop: bool = False
    garbage: bool = False
    transaction_id: int = 0
    answer_unit: int | None = None
    truncate: int | None = None
    close: bool = False
    reset: bool = False
    ack_only: bool = False
    answer_values: tuple[int, ...] | None = None


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make.

    Raises:
        ValueError: a rule is not understood.
    """

    def __init__(self, rules: list[dict[str, Any]]) -> None:
        super().__init__([_read(rule) for rule in rules])

    def match(self, unit: int, request: Mapping[str, Any]) -> Rule | None:
        """Return the rule that applies to this request, if any; count it."""
        return self.first(
            lambda rule: (
                rule.function in (None, request["function"])
                and rule.address in (None, request.get("address"))
                and rule.unit in (None, unit)
            )
        )


def _read(source: Mapping[str, Any]) -> Rule:
    values = _TABLE.read(source)
    if "answer_values" in values:
        values["answer_values"] = tuple(values["answer_values"])
    return Rule(**values)
