"""The server's fault plan: which service call is treated how, first match wins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from asyncua import ua

__all__ = ["FaultPlan", "Rule"]

_CONDITIONS = ("service", "node", "times")


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One rule: conditions (None matches everything), how often it applies, and what happens.

    Attributes:
        status: every item is answered with this status code, by symbol, and not executed.
        service_fault: the whole call is answered with a ServiceFault of this symbol.
        delay_s: it is executed that many seconds later.
        close: the connections are aborted; the call is not executed.
    """

    service: str | None = None
    node: str | None = None
    times: int | None = None
    status: str | None = None
    service_fault: str | None = None
    delay_s: float = 0.0
    close: bool = False

    @classmethod
    def read(cls, source: Mapping[str, Any]) -> Rule:
        """A rule from the control channel: conditions at the top, what happens under ``action``.

        Raises:
            ValueError: an unknown name.
        """
        action = source.get("action")
        if not isinstance(action, Mapping) or not action:
            raise ValueError("a fault rule needs an action, for instance {'action': {'status': 'BadDeviceFailure'}}")
        actions = {field.name for field in fields(cls)} - set(_CONDITIONS)
        for name in (*(set(source) - {"action"} - set(_CONDITIONS)), *(set(action) - actions)):
            raise ValueError(f"unknown member {name!r} of a fault rule")
        for name in ("status", "service_fault"):
            if action.get(name) is not None and not hasattr(ua.StatusCodes, action[name]):
                raise ValueError(f"unknown status code {action[name]!r}")
        return cls(**{name: value for name, value in source.items() if name != "action"}, **action)


class FaultPlan:
    """Rules in order, with a count of how often each was applied."""

    def __init__(self, rules: list[dict[str, Any]]) -> None:
        self._rules = [Rule.read(rule) for rule in rules]
        self.hits = [0] * len(self._rules)

    def match(self, service: str, nodes: Sequence[str]) -> Rule | None:
        """The rule that applies to this call, if any; counts it."""
        for index, rule in enumerate(self._rules):
            if (
                rule.service in (None, service)
                and (rule.node is None or rule.node in nodes)
                and (rule.times is None or self.hits[index] < rule.times)
            ):
                self.hits[index] += 1
                return rule
        return None
