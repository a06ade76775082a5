"""The server's fault plan: which service call is treated how, first match wins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from asyncua import ua

__all__ = ["NOTHING", "FaultPlan", "Rule"]

_CONDITIONS = ("service", "node", "times")


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One rule: conditions (None matches everything), how often it applies, and what happens.

    Attributes:
        service: name of the service as in the journal, for instance ``Read``.
        node: node id that the request must name among others.
        times: applied at most this often, None without limit.
        status: every item is answered with this status code, by symbol, and not executed.
        service_fault: the whole call is answered with a ServiceFault of this symbol and not executed.
        delay_s: it is executed that many seconds later; later requests are not held up by it.
        ack_only: a write is acknowledged with Good, and not done.
        clamp: the number that a write stores instead, acknowledged with GoodClamped.
        drop: executed, but not answered.
        close, reset: executed; then the connection is closed, or reset, without an answer.
    """

    service: str | None = None
    node: str | None = None
    times: int | None = None
    status: str | None = None
    service_fault: str | None = None
    delay_s: float = 0.0
    ack_only: bool = False
    clamp: float | None = None
    drop: bool = False
    close: bool = False
    reset: bool = False

    @classmethod
    def read(cls, source: Mapping[str, Any]) -> Rule:
        """A rule from the control channel: conditions at the top, what happens under ``action``.

        Raises:
            ValueError: an unknown name, or a value that the name cannot have.
        """
        action = source.get("action")
        if not isinstance(action, Mapping) or not action:
            raise ValueError("a fault rule needs an action, for instance {'action': {'status': 'BadDeviceFailure'}}")
        actions = {field.name for field in fields(cls)} - set(_CONDITIONS)
        for name in (*(set(source) - {"action"} - set(_CONDITIONS)), *(set(action) - actions)):
            raise ValueError(f"unknown member {name!r} of a fault rule")
        values: dict[str, Any] = {**source, **action}
        del values["action"]
        for name, value in values.items():
            if not _ACCEPTED[name](value):
                raise ValueError(f"a fault rule cannot have {value!r} as {name!r}")
        return cls(**values)


def _flag(value: Any) -> bool:
    return isinstance(value, bool)


def _number(value: Any) -> bool:
    return type(value) in (int, float)


def _symbol(value: Any) -> bool:
    return isinstance(value, str) and isinstance(getattr(ua.StatusCodes, value, None), int)


_ACCEPTED = {
    "service": lambda value: isinstance(value, str),
    "node": lambda value: isinstance(value, str),
    "times": lambda value: type(value) is int and value >= 0,
    "status": _symbol,
    "service_fault": _symbol,
    "delay_s": lambda value: _number(value) and 0 <= value <= 600,
    "ack_only": _flag,
    "clamp": _number,
    "drop": _flag,
    "close": _flag,
    "reset": _flag,
}

NOTHING = Rule()
"""What applies to a call that no rule matches."""


class FaultPlan:
    """Rules in order, with a count of how often each was applied."""

    def __init__(self, rules: list[dict[str, Any]]) -> None:
        self._rules = [Rule.read(rule) for rule in rules]
        self.hits = [0] * len(self._rules)

    def __bool__(self) -> bool:
        return bool(self._rules)

    def match(self, service: str, nodes: Sequence[str]) -> Rule:
        """The rule that applies to this call, or :data:`NOTHING`; counts it."""
        for index, rule in enumerate(self._rules):
            if (
                rule.service in (None, service)
                and (rule.node is None or rule.node in nodes)
                and (rule.times is None or self.hits[index] < rule.times)
            ):
                self.hits[index] += 1
                return rule
        return NOTHING
