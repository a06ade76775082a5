"""A finding: one fault of the adapter, in words that name what was expected and what was seen. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Finding"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One fault of the adapter under test.

    Attributes:
        code: stable identifier of the kind of fault, such as ``wrong_value``.
        message: one sentence: what was expected and what was seen.
        requirement: id in the requirement catalogue, or None.
        evidence: an excerpt of the wire or of the device, or None.
        strength: of the requirement; only a MUST that is not met turns an item red.
        cause: the item or finding that found the same cause first; None when this one did.
    """

    code: str
    message: str
    requirement: str | None = None
    evidence: str | None = None
    strength: Literal["MUST", "SHOULD"] = "MUST"
    cause: str | None = None

    @property
    def is_must(self) -> bool:
        """Whether a MUST is not met; otherwise the finding is a warning."""
        return self.strength == "MUST"
