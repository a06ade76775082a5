"""A finding: one fault of the adapter, in words that name what was expected and what was seen. Pure."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

__all__ = ["Finding", "Kind", "kind_of"]

Kind = tuple[str, str | None, str]
"""What findings of the same fault have in common: code, requirement, and the message without its values."""

_VALUES = re.compile(r"[0-9a-f]{8,}|-?\d+(?:\.\d+)?")
"""Values differ from one repetition to the next, so that no answer from memory can pass."""


_LONGEST = 10_000
"""Characters of a message; a longer one is cut off."""


def kind_of(code: str, requirement: str | None, message: str) -> Kind:
    """Return the kind of a finding: equal for one that another repetition makes of the same fault."""
    return code, requirement, _VALUES.sub("#", message)


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

    def __post_init__(self) -> None:
        if len(self.message) > _LONGEST:
            # An adapter's words may be megabytes, and reports repeat them in many places.
            # What is cut off is short enough not to be cut again when a record is read.
            end = f"… ({len(self.message)} characters)"
            object.__setattr__(self, "message", self.message[: _LONGEST - len(end)] + end)

    @property
    def is_must(self) -> bool:
        """Whether a MUST is not met; otherwise the finding is a warning."""
        return self.strength == "MUST"
