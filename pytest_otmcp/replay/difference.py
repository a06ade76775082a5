"""What a record and a judgement of its history disagree in. Pure."""

from __future__ import annotations

import json
from dataclasses import dataclass

from ..record.schema import Finding

__all__ = ["Difference", "FindingDiffers", "MemberDiffers", "Objection"]

_LONGEST = 200


@dataclass(frozen=True, slots=True)
class Objection:
    """A history that cannot be true, or that the steps do not fit.

    Attributes:
        where: the item, with its repetition or another part of it; in a sentence about a device, the device.
        reason: why.
    """

    where: str
    reason: str

    def __str__(self) -> str:
        return f"{self.where}: {self.reason}"


@dataclass(frozen=True, slots=True)
class MemberDiffers:
    """A member that follows from the history otherwise than the record has it.

    Attributes:
        where: the item, with its repetition and its call.
        name: of the member.
        shown: what follows from the history.
        stated: what the record says.
    """

    where: str
    name: str
    shown: object
    stated: object

    def __str__(self) -> str:
        return f"{self.where}: the stored history shows {self.name} {short(self.shown)}, the record says {short(self.stated)}"


@dataclass(frozen=True, slots=True)
class FindingDiffers:
    """A finding that either the history shows or the record says.

    Attributes:
        where: the item, with its repetition.
        finding: as records have it.
        is_shown: the history shows it; the record says it otherwise.
    """

    where: str
    finding: Finding
    is_shown: bool

    def __str__(self) -> str:
        warning = "" if self.finding["strength"] == "MUST" else ", a warning"
        told = f"{self.finding['message']!r} ({self.finding['code']}{warning})"
        if self.is_shown:
            return f"{self.where}: the stored history shows {told}, the record says nothing of it"
        return f"{self.where}: the record says {told}, the stored history does not show it"


Difference = Objection | MemberDiffers | FindingDiffers
"""One disagreement; as a text it is a sentence."""


def short(value: object) -> str:
    """Return a JSON value as a text that fits into a sentence."""
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _LONGEST else text[:_LONGEST] + "…"
