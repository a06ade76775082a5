"""Fault plans: rules that say which fault a device applies to which request. The first rule that fits applies.

Where a rule has ``skip``, so many requests that fit pass it first; then it applies ``times`` times (without it: to all that follow). A
request that passes a rule, or finds it used up, is offered to the next one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Generic, TypeVar

from .fault_rules import Table
from .network import AT_ONCE, Manner

__all__ = ["FaultRule", "Plan"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultRule:
    """What a rule of any protocol has beside its own conditions (None matches everything) and actions.

    Attributes:
        skip: so many requests that fit pass first.
        times: applied at most this often, None without limit.
        action: the action as it was given, for the journal.
        manner: how the answer travels, see :class:`~.network.Manner`.
    """

    skip: int = 0
    times: int | None = None
    action: Mapping[str, Any] = field(default_factory=dict)
    manner: Manner = AT_ONCE


R = TypeVar("R", bound=FaultRule)


class Plan(Generic[R]):
    """Rules in order, as the control channel gives them and the table of a protocol reads them, with a count of how often each was applied.

    Raises:
        ValueError: a rule is not understood.

    Attributes:
        table: conditions and actions of the protocol.
        rule: makes a rule of their values.
        hits: number of applications, by rule.
    """

    table: ClassVar[Table]
    rule: ClassVar[Callable[..., Any]]

    def __init__(self, rules: Sequence[Mapping[str, Any]]) -> None:
        self._rules = [self._read(rule) for rule in rules]
        self.hits = [0] * len(self._rules)
        self._skipped = [0] * len(self._rules)

    def _read(self, source: Mapping[str, Any]) -> R:
        values = self.table.read(source)
        rule: R = self.rule(action=dict(source["action"]), manner=Manner.of(values), **values)
        return rule

    def __bool__(self) -> bool:
        return bool(self._rules)

    def first(self, fits: Callable[[R], bool]) -> R | None:
        """Return the first rule that fits, has let enough requests pass and has not been applied too often yet; count it."""
        for index, rule in enumerate(self._rules):
            if (rule.times is not None and self.hits[index] >= rule.times) or not fits(rule):
                continue
            if self._skipped[index] < rule.skip:
                self._skipped[index] += 1
                continue
            self.hits[index] += 1
            return rule
        return None
