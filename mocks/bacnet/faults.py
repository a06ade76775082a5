"""The fault plan of the BACnet device: which request gets which fault."""

from __future__ import annotations

import struct
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from pytest_otmcp.wire.bacnet.values import Value, encode

from ..fault_plan import FaultRule, Plan
from ..fault_rules import FLAG, SKIP, Field, Table, integer, number
from ..network import MANNERS
from .names import ObjectType

__all__ = ["TABLE", "FaultPlan", "Rule", "identifier_of"]

_BYTE = integer(0, 0xFF)
_BY_TEXT = {kind.text: int(kind) for kind in ObjectType}


def identifier_of(text: Any) -> tuple[int, int] | None:
    """Return type and instance of an object such as ``analog-input,1``; None where the text names none."""
    kind, comma, instance = text.partition(",") if isinstance(text, str) else ("", "", "")
    if not comma or kind not in _BY_TEXT or not instance.isdecimal() or int(instance) > 4194302:
        return None
    return _BY_TEXT[kind], int(instance)


def _is_pair(value: object, accepts: Field) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(accepts.accepts, value))


def _is_values(value: object) -> bool:
    if not isinstance(value, list):
        return False
    try:
        for one in value:
            encode(Value(kind=one["type"], value=one["value"]))
    except (AttributeError, KeyError, IndexError, OverflowError, TypeError, ValueError, struct.error):
        return False
    return True


TABLE = Table(
    conditions={
        "service": integer(0, 0xFF),
        "object": Field(
            accepts=lambda value: identifier_of(value) is not None,
            expected="such as 'analog-input,1'",
            convert=identifier_of,
        ),
        "discovery": FLAG,
        "skip": SKIP,
    },
    actions={
        "error": Field(
            accepts=lambda value: _is_pair(value, integer(0, 0xFFFF)),
            expected="a list of error class and error code",
            convert=tuple,
        ),
        "reject": _BYTE,
        "abort": _BYTE,
        "delay_s": number(0, 3600),
        "drop": FLAG,
        "lose": FLAG,
        "garbage": FLAG,
        "invoke_id": integer(-0xFF, 0xFF),
        "answer_instance": integer(0, 4194302),
        "answer_values": Field(
            accepts=_is_values,
            expected="a list of objects with type and value",
            convert=lambda given: [Value(kind=one["type"], value=one["value"]) for one in given],
        ),
        "clamp": Field(
            accepts=lambda value: _is_pair(value, number()) and value[0] <= value[1],
            expected="a list of two numbers, the lower one first",
            convert=tuple,
        ),
        "truncate": integer(0, 1500),
        "ack_only": FLAG,
        "duplicate": MANNERS["duplicate"],
        "mangle": MANNERS["mangle"],
    },
    example="{'drop': true}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule(FaultRule):
    """One rule: conditions (None matches everything), how often it applies, and what happens beside what :class:`FaultRule` has.

    Attributes:
        service: number of a confirmed service.
        object: type and instance of an object that the request is about.
        discovery: True for Who-Is alone, which no other rule concerns.
        error, reject, abort: answer with this error (class and code), reject reason or abort reason; nothing is executed.
        delay_s: answer this many seconds later; later requests are not delayed by it.
        drop: execute, but do not answer.
        lose: neither execute nor answer.
        garbage: execute, answer with bytes that are no BACnet/IP.
        invoke_id: added to the invoke id of the answer.
        answer_instance: instance of the objects that the answer to a read names.
        answer_values: values that a successful ReadProperty answers with.
        clamp: an analog present value that is written is stored not lower and not higher than these two numbers.
        truncate: send only this many bytes of the answer.
        ack_only: acknowledge a write without doing it.
    """

    service: int | None = None
    object: tuple[int, int] | None = None
    discovery: bool = False
    error: tuple[int, int] | None = None
    reject: int | None = None
    abort: int | None = None
    delay_s: float = 0.0
    drop: bool = False
    lose: bool = False
    garbage: bool = False
    invoke_id: int = 0
    answer_instance: int | None = None
    answer_values: Sequence[Value] | None = None
    clamp: tuple[float, float] | None = None
    truncate: int | None = None
    ack_only: bool = False


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make."""

    table, rule = TABLE, Rule

    def match(self, service: int, objects: Collection[tuple[int, int]]) -> Rule | None:
        """Return the rule that applies to a confirmed request, if any; count it."""
        return self.first(
            lambda rule: (
                not rule.discovery
                and rule.service in (None, service)
                and (rule.object is None or rule.object in objects)
            )
        )

    def match_discovery(self) -> Rule | None:
        """Return the rule that applies to a Who-Is, if any; count it."""
        return self.first(lambda rule: rule.discovery)
