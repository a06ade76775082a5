"""The fault plan: which request is answered how, first match wins."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

__all__ = ["FaultPlan", "Rule"]

_CONDITIONS = ("function", "address", "unit", "times")


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One rule: conditions (None matches everything), how often it applies, and what happens.

    Attributes:
        times: applied at most this often, None without limit.
        exception: answer with this exception code; the request is not executed.
        delay_s: answer that many seconds later; later requests are not held up by it.
        drop: execute, but do not answer.
        garbage: execute, answer with bytes that are no MBAP frame.
        transaction_id: added to the transaction identifier of the answer.
        answer_unit: unit identifier of the answer.
        truncate: send only that many bytes of the answer.
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

    @classmethod
    def read(cls, source: Mapping[str, Any]) -> Rule:
        """A rule from the control channel: conditions at the top, what happens under ``action``.

        Raises:
            ValueError: an unknown name, or a value that the name cannot have.
        """
        action = source.get("action")
        if not isinstance(action, Mapping) or not action:
            raise ValueError("a fault rule needs an action, for instance {'action': {'drop': true}}")
        known = {field.name for field in fields(cls)}
        for name in (*(set(source) - {"action"} - set(_CONDITIONS)), *(set(action) - (known - set(_CONDITIONS)))):
            raise ValueError(f"unknown member {name!r} of a fault rule")
        values: dict[str, Any] = {**source, **action}
        del values["action"]
        for name, value in values.items():
            if value is not None and not _ACCEPTS[name](value):
                raise ValueError(f"a fault rule cannot have {value!r} as {name!r}")
        # None means: as if it had not been said.
        values = {name: value for name, value in values.items() if value is not None}
        if "answer_values" in values:
            values["answer_values"] = tuple(values["answer_values"])
        return cls(**values)


def _integer(lowest: int, highest: int) -> Callable[[Any], bool]:
    return lambda value: type(value) is int and lowest <= value <= highest


def _registers(value: Any) -> bool:
    return isinstance(value, list) and len(value) <= 125 and all(map(_integer(0, 0xFFFF), value))


def _boolean(value: Any) -> bool:
    return isinstance(value, bool)


_ACCEPTS: dict[str, Callable[[Any], bool]] = {
    "function": _integer(0, 0xFF),
    "address": _integer(0, 0xFFFF),
    "unit": _integer(0, 0xFF),
    "times": _integer(0, sys.maxsize),
    "exception": _integer(0, 0xFF),
    "delay_s": lambda value: type(value) in (int, float) and 0 <= value <= 3600,
    "drop": _boolean,
    "garbage": _boolean,
    "transaction_id": _integer(-0xFFFF, 0xFFFF),
    "answer_unit": _integer(0, 0xFF),
    "truncate": _integer(0, 260),
    "close": _boolean,
    "reset": _boolean,
    "ack_only": _boolean,
    "answer_values": _registers,
}


class FaultPlan:
    """Rules in order, with a count of how often each was applied."""

    def __init__(self, rules: list[dict[str, Any]]) -> None:
        self._rules = [Rule.read(rule) for rule in rules]
        self.hits = [0] * len(self._rules)

    def match(self, unit: int, request: Mapping[str, Any]) -> Rule | None:
        """The rule that applies to this request, if any; counts it."""
        for index, rule in enumerate(self._rules):
            if (
                rule.function in (None, request["function"])
                and rule.address in (None, request.get("address"))
                and rule.unit in (None, unit)
                and (rule.times is None or self.hits[index] < rule.times)
            ):
                self.hits[index] += 1
                return rule
        return None
