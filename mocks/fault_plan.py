"""What the fault plans of all devices have in common: how a rule of the control channel becomes one of a protocol's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar

from .fault_rules import Plan, Table
from .network import AT_ONCE, Manner

__all__ = ["FaultRule", "TablePlan"]


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


class TablePlan(Plan[R]):
    """The plan that the rules of the control channel make, as the table of a protocol says.

    Raises:
        ValueError: a rule is not understood.

    Attributes:
        table: conditions and actions of the protocol.
        rule: makes a rule of their values.
    """

    table: ClassVar[Table]
    rule: ClassVar[Callable[..., Any]]

    def __init__(self, rules: list[dict[str, Any]]) -> None:
        super().__init__([self._read(rule) for rule in rules])

    def _read(self, source: Mapping[str, Any]) -> R:
        values = self.table.read(source)
        rule: R = self.rule(action=dict(source["action"]), manner=Manner.of(values), **values)
        return rule
