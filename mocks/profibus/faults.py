"""The fault plan of the PROFIBUS segment: which request gets which fault."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..fault_rules import FLAG, SKIP, Field, Plan, Table, integer, number, one_of
from ..network import MANNERS, Mangling
from .services import SERVICES

__all__ = ["TABLE", "FaultPlan", "Rule"]

_HEX = re.compile("(?:[0-9a-f]{2}){0,244}")
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
        "answer_data": Field(
            accepts=lambda value: isinstance(value, str) and bool(_HEX.fullmatch(value)),
            expected="at most 244 bytes as hexadecimal digits",
        ),
        "drip_s": MANNERS["drip_s"],
        "duplicate": MANNERS["duplicate"],
        "mangle": MANNERS["mangle"],
    },
    example="{'drop': true}",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One rule: conditions (None matches everything), how often it applies, and what happens.

    Attributes:
        service: what the request asks for.
        station: that is asked.
        changes: True for a Data_Exchange with other outputs than the slave holds, False for every other request.
        skip: so many requests that fit pass first.
        times: applied at most this often, None without limit.
        action: the action as it was given, for the journal.
        error: not executed; the answer has no data and this function: 1 UE, 2 RR, 3 RS, 9 NR.
        delay_s: answer this many seconds later; later requests are not delayed by it.
        drop: execute, but do not answer.
        lose: neither execute nor answer.
        garbage: execute, answer with bytes that are no telegram.
        truncate: send only this many bytes of the answer.
        ack_only: answer as if it were done, without doing it.
        answer_station, answer_master: source and destination address of the answer.
        answer_data: bytes that an answer with data has.
        drip_s: send the bytes of the answer one by one, so many seconds apart.
        duplicate: send the answer twice.
        mangle: change the answer's bytes; the journal has what was sent, as an entry ``mangled``, in its place.
    """

    service: str | None = None
    station: int | None = None
    changes: bool | None = None
    skip: int = 0
    times: int | None = None
    action: Mapping[str, Any] = field(default_factory=dict)
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
    drip_s: float = 0.0
    duplicate: bool = False
    mangle: Mangling | None = None


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make.

    Raises:
        ValueError: a rule is not understood.
    """

    def __init__(self, rules: list[dict[str, Any]]) -> None:
        super().__init__([_read(rule) for rule in rules])

    def match(self, service: str, station: int, *, changes: bool) -> Rule | None:
        """Return the rule that applies to a request, if any; count it."""
        return self.first(
            lambda rule: (
                rule.service in (None, service) and rule.station in (None, station) and rule.changes in (None, changes)
            )
        )


def _read(source: Mapping[str, Any]) -> Rule:
    values = TABLE.read(source)
    if "answer_data" in values:
        values["answer_data"] = bytes.fromhex(values["answer_data"])
    if "mangle" in values:
        values["mangle"] = Mangling(**values["mangle"])
    return Rule(action=dict(source["action"]), **values)
