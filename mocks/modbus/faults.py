"""The fault plan: which request is answered how, first match wins."""

from __future__ import annotations

from collections.abc import Mapping
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
        delay_s: answer that many seconds later.
        drop: execute, but do not answer.
        garbage: execute, answer with bytes that are no MBAP frame.
        transaction_id: added to the transaction identifier of the answer.
        answer_unit: unit identifier of the answer.
        truncate: send only that many bytes of the answer.
        close, reset: execute, then close the connection, or reset it.
        ack_only: acknowledge a write without doing it.
        answer_values: registers that a read answers with.
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
            ValueError: an unknown name.
        """
        action = source.get("action")
        if not isinstance(action, Mapping) or not action:
            raise ValueError("a fault rule needs an action, for instance {'action': {'drop': true}}")
        known = {field.name for field in fields(cls)}
        for name in (*(set(source) - {"action"} - set(_CONDITIONS)), *(set(action) - (known - set(_CONDITIONS)))):
            raise ValueError(f"unknown member {name!r} of a fault rule")
        values = dict(source, **action)
        del values["action"]
        if values.get("answer_values") is not None:
            values["answer_values"] = tuple(values["answer_values"])
        return cls(**values)


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
