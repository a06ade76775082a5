"""What a run over one defective adapter showed."""

from __future__ import annotations

from dataclasses import dataclass

from .defect import Defect

__all__ = ["Seen"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What a run over one defective adapter showed.

    Attributes:
        items: ids of the items that did not pass.
        requirements: requirements that the findings cite, and codes of findings that cite none.
        faults: why items could not be judged: faults of the kit or of its machine.
        words: some findings, each with its item; those that the defect does not declare come first.
    """

    items: frozenset[str]
    requirements: frozenset[str]
    faults: tuple[str, ...]
    words: tuple[str, ...]

    def is_expected(self, defect: Defect) -> bool:
        """Tell whether exactly the items failed that must, for exactly these requirements."""
        expected = frozenset(defect.items), frozenset(defect.requirements)
        return not self.faults and (self.items, self.requirements) == expected
