"""What an adapter was told: the targets that may be written, limits of their values, limits of time, and its policy. Pure.

Targets have the names of the points in a device's image; a device without such an image, as a broker is, has them by the protocol's own
names, such as topics.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any

__all__ = ["Bounds", "Governance", "Limit", "Scopes", "Times"]

_RANGE = re.compile(r"(\d+)\.\.(\d+)|\*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """Limits of the number that a target holds, in the device's own terms; None where there is no such limit.

    Attributes:
        lowest, highest: may be written themselves.
        step: the most by which one write may change it.
        every_s: seconds that have to lie between two writes.
    """

    lowest: float | None = None
    highest: float | None = None
    step: float | None = None
    every_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """What an adapter was told.

    Attributes:
        allowed: names of targets that may be written; ``10..19`` in a name stands for these numbers, ``*`` for any characters but ``/``.
            Empty for an adapter that was told no targets.
        limits: of targets, by name.
    """

    allowed: Sequence[str] = ()
    limits: Mapping[str, Limit] = field(default_factory=dict)

    def allows(self, target: str) -> bool:
        """Tell whether a target is on the list."""
        return not self.allowed or any(_covers(pattern, target) for pattern in self.allowed)

    def as_record(self) -> dict[str, Any]:
        """Return this as a run record has it."""
        limits = {target: _stated(limit) for target, limit in self.limits.items()}
        return {"allowed": list(self.allowed), "limits": limits}

    @classmethod
    def of_record(cls, stated: Mapping[str, Any]) -> Bounds:
        """Return what a subject file or a run record states."""
        limits = {target: Limit(**limit) for target, limit in stated["limits"].items()}
        return cls(allowed=tuple(stated["allowed"]), limits=limits)


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """What follows from the time limits and numbers of repetitions that an adapter was told, as its author states it.

    Attributes:
        deadline_s: seconds within which a call to a silent device has ended.
        attempts: how often such a call sends a request that reads; None where the author does not say.
    """

    deadline_s: float
    attempts: int | None = None

    def as_record(self) -> dict[str, Any]:
        """Return this as a run record has it."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    @classmethod
    def of_record(cls, stated: Mapping[str, Any]) -> Times:
        """Return what a subject file or a run record states."""
        return cls(deadline_s=float(stated["deadline_s"]), attempts=stated.get("attempts"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Scopes:
    """The scopes of tokens, as the author of an adapter states them; several are separated by blanks.

    Attributes:
        writes: of a caller who may write.
        reads: of one who may read alone; None where the adapter knows no such caller.
    """

    writes: str
    reads: str | None = None

    def as_record(self) -> dict[str, Any]:
        """Return this as a run record has it."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    @classmethod
    def of_record(cls, stated: Mapping[str, Any]) -> Scopes:
        """Return what a subject file or a run record states."""
        return cls(writes=stated["writes"], reads=stated.get("reads"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Governance:
    """What an adapter with a policy was told, and what it has to show, as its author states it.

    Attributes:
        bounds: what the caller may write without asking, and limits, also those of the target that a person approves.
        viewer: it can be launched for a caller who may write nothing.
        audit: ``fields`` (JMESPath by what is found there), ``anchor`` (JMESPath in an answer), ``digest`` (values are not written out),
            ``is_file`` and ``verifies`` (there is a verifier); None for an adapter without a log.
        approval: ``target`` (every write of it needs an approval), ``by`` (``client`` or ``outside``), ``id`` (JMESPath in a refusal), and
            ``expires_s`` where it is stated; None for an adapter without approvals.
    """

    bounds: Bounds
    viewer: bool
    audit: Mapping[str, Any] | None
    approval: Mapping[str, Any] | None

    def as_record(self) -> dict[str, Any]:
        """Return this as a run record has it."""
        parts = {"audit": self.audit, "approval": self.approval}
        stated = {name: dict(part) for name, part in parts.items() if part is not None}
        return {**self.bounds.as_record(), "viewer": self.viewer, **stated}

    @classmethod
    def of_record(cls, stated: Mapping[str, Any]) -> Governance:
        """Return what a run record states."""
        return cls(
            bounds=Bounds.of_record(stated),
            viewer=stated["viewer"],
            audit=stated.get("audit"),
            approval=stated.get("approval"),
        )


def _stated(limit: Limit) -> dict[str, float]:
    return {name: value for name, value in asdict(limit).items() if value is not None}


def _covers(pattern: str, target: str) -> bool:
    expression, ranges = _compiled(pattern)
    match = expression.fullmatch(target)
    return match is not None and all(
        first <= int(found) <= last for found, (first, last) in zip(match.groups(), ranges, strict=True)
    )


@cache
def _compiled(pattern: str) -> tuple[re.Pattern[str], tuple[tuple[int, int], ...]]:
    parts, ranges, end = [], [], 0
    for place in _RANGE.finditer(pattern):
        parts.append(re.escape(pattern[end : place.start()]))
        end = place.end()
        if place[1] is None:
            parts.append("[^/]*")
        else:
            parts.append("([0-9]{1,9})")
            ranges.append((int(place[1]), int(place[2])))
    return re.compile("".join(parts) + re.escape(pattern[end:])), tuple(ranges)
