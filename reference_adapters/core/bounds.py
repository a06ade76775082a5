"""What may be written, and between which limits: a list of targets and limits of their values, checked before anything is sent.

Each tool that writes says what it changes as targets and values (:meth:`~.call.Call.changes`), in the words of its own protocol. One that
does not say it may write nothing while there is a list.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from .errors import AdapterError
from .settings import ConfigError, Environment

__all__ = ["Bounds", "covers"]

_ALLOW, _LIMITS = "OT_WRITE_ALLOW", "OT_WRITE_LIMITS"
_PLACES = re.compile(r"(\d+)\.\.(\d+)|\*")

T = TypeVar("T")


class _Limit(BaseModel):
    """Limits of a number: the lowest and the highest, the largest step from the last one, and the seconds between two writes."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)

    lowest: float | None = None
    highest: float | None = None
    step: float | None = None
    every_s: float | None = None


class Bounds:
    """The targets that may be written, and the limits of their values.

    Args:
        allowed: names of targets; ``10..19`` in a name stands for these numbers, ``*`` for any characters but ``/``. None for any target.
        limits: of targets, by their exact names.
    """

    def __init__(self, allowed: list[str] | None, limits: Mapping[str, _Limit]) -> None:
        self._allowed = allowed
        self._limits = limits
        self._last: dict[str, tuple[float, float]] = {}

    @classmethod
    def of(cls, environment: Environment) -> Bounds | None:
        """Return the bounds that ``OT_WRITE_ALLOW`` and ``OT_WRITE_LIMITS`` set, as JSON; None where neither is set.

        Raises:
            ConfigError: one of them cannot be understood, so that nothing would be kept.
        """
        if environment.optional(_ALLOW) is None and environment.optional(_LIMITS) is None:
            return None
        allowed = _json(environment, _ALLOW, TypeAdapter(list[str]))
        return cls(allowed, _json(environment, _LIMITS, TypeAdapter(dict[str, _Limit])) or {})

    def check(self, changes: Sequence[tuple[str, object]]) -> None:
        """Refuse changes of which one is not allowed or beyond a limit: all of them, before anything is sent.

        Args:
            changes: targets, each with the number that it gets; with None, or another value, where it is no number.

        Raises:
            AdapterError: ``access_denied``, ``range_overflow`` or ``rate_limited``.
        """
        for target, _ in changes:
            if self._allowed is not None and not any(covers(pattern, target) for pattern in self._allowed):
                message = f"a target is not on the list of those that may be written ({_ALLOW})"
                raise AdapterError("access_denied", message, outcome="not_sent", details={"target": target})
        now = time.monotonic()
        numbers = [
            (target, _within(target, value, limit, self._last.get(target), now))
            for target, value in changes
            if (limit := self._limits.get(target)) is not None
        ]
        # Whether the device takes it is not known yet: what may be there counts.
        self._last |= {target: (number, now) for target, number in numbers}


def _within(target: str, value: object, limit: _Limit, last: tuple[float, float] | None, now: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _beyond(target, "has limits, and the value is no finite number", limit)
    if limit.lowest is not None and value < limit.lowest:
        raise _beyond(target, "gets a value below its lowest", limit)
    if limit.highest is not None and value > limit.highest:
        raise _beyond(target, "gets a value above its highest", limit)
    if last is None:
        return value
    number, at = last
    if limit.step is not None and abs(value - number) > limit.step:
        raise _beyond(target, "changes by more than its largest step", limit)
    if limit.every_s is not None and now - at < limit.every_s:
        message = f"a target has changed a moment ago ({_LIMITS})"
        after = math.ceil(1000 * (limit.every_s - (now - at)))
        raise AdapterError("rate_limited", message, outcome="not_sent", retry_after_ms=after)
    return value


def _beyond(target: str, what: str, limit: _Limit) -> AdapterError:
    return AdapterError(
        "range_overflow",
        f"a target {what} ({_LIMITS})",
        outcome="not_sent",
        allowed=limit.model_dump(exclude_none=True),
        details={"target": target},
    )


def _json(environment: Environment, name: str, kind: TypeAdapter[T]) -> T | None:
    text = environment.optional(name)
    if text is None:
        return None
    try:
        return kind.validate_json(text)
    except ValidationError as error:
        fault = error.errors(include_url=False, include_input=False)[0]
        raise ConfigError(f"{name}: {'/'.join(map(str, fault['loc'])) or 'the text'}: {fault['msg']}") from None


def covers(pattern: str, target: str) -> bool:
    """Tell whether a target has the name that a pattern describes, see :class:`Bounds`."""
    expression, ranges = _expression(pattern)
    match = expression.fullmatch(target)
    return match is not None and all(int(found) in one for found, one in zip(match.groups(), ranges, strict=True))


@lru_cache(maxsize=4096)
def _expression(pattern: str) -> tuple[re.Pattern[str], list[range]]:
    parts, ranges, end = [], [], 0
    for place in _PLACES.finditer(pattern):
        parts += [re.escape(pattern[end : place.start()]), "[^/]*" if place[1] is None else "([0-9]{1,9})"]
        ranges += [] if place[1] is None else [range(int(place[1]), int(place[2]) + 1)]
        end = place.end()
    return re.compile("".join(parts) + re.escape(pattern[end:])), ranges
