"""The kill matrix: what was noticed, by what, and whether that is what was to be. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..core.verdict import ExitCode
from ..suite.requirements import Requirement
from .defect import Declared, Defect
from .seen import Seen

__all__ = ["KillMatrix", "Outcome"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A defect, and what a run over it showed.

    Attributes:
        seconds: how long the run took.
    """

    defect: Defect
    seen: Seen
    seconds: float

    @property
    def is_expected(self) -> bool:
        """Exactly the items failed that must, for exactly these requirements."""
        return self.seen.is_expected(self.defect)

    @property
    def is_warning(self) -> bool:
        """The defect breaks no MUST: it is as declared, and no item failed."""
        return self.is_expected and not self.seen.items

    @property
    def word(self) -> str:
        """What became of the defect, in a word or two."""
        if self.is_expected:
            return "warned" if self.is_warning else "noticed"
        if self.seen.faults:
            return "NOT JUDGED"
        return "OTHERWISE" if self.seen.items or self.seen.requirements else "NOT NOTICED"


@dataclass(frozen=True, slots=True, kw_only=True)
class KillMatrix:
    """What a self-check has shown.

    Attributes:
        declared: all defects, with those that nothing notices yet.
        outcomes: of the defects that were run, in the order of the catalogue.
        checks: id of each check of the requirement suite to the row of the catalogue that it judges.
        rows: the requirement catalogue by id.
    """

    declared: Declared
    outcomes: Sequence[Outcome]
    checks: Mapping[str, str]
    rows: Mapping[str, Requirement]

    @property
    def is_whole(self) -> bool:
        """Every declared defect was run."""
        return len(self.outcomes) == len(self.declared.defects)

    @property
    def noticed(self) -> list[Outcome]:
        """The defects that exactly what must notice them has noticed."""
        return [one for one in self.outcomes if one.is_expected]

    @property
    def warned(self) -> list[Outcome]:
        """Those of them that cost a warning and fail no item: they break what the catalogue only recommends."""
        return [one for one in self.noticed if one.is_warning]

    @property
    def unexpected(self) -> list[Outcome]:
        """The others."""
        return [one for one in self.outcomes if not one.is_expected]

    @property
    def shown(self) -> set[str]:
        """Ids of the catalogue's defects, without letters, of which a variant was run and all that were run were noticed."""
        return {one.defect.catalogue_id for one in self.noticed} - {one.defect.catalogue_id for one in self.unexpected}

    @property
    def covered(self) -> set[str]:
        """Ids of the catalogue's defects, without letters, that an adapter has."""
        return {one.catalogue_id for one in self.declared.defects}

    @property
    def musts(self) -> set[str]:
        """The rows of the catalogue that are a MUST and have a check."""
        return {row for row in self.checks.values() if self.rows[row].strength == "MUST"}

    @property
    def killed(self) -> set[str]:
        """Those of them whose check failed, as it must, for a defect."""
        return {self.checks[item] for one in self.noticed for item in one.seen.items & self.checks.keys()} & self.musts

    @property
    def unjudged(self) -> dict[str, str]:
        """The rows that are a MUST and have no check, with the reason."""
        return {row.id: row.not_yet for row in self.rows.values() if row.strength == "MUST" and row.not_yet is not None}

    @property
    def exit_code(self) -> ExitCode:
        """Conformant when each defect was noticed as it must be, and by a whole run every MUST that has a check."""
        if any(not one.seen.faults for one in self.unexpected) or (self.is_whole and self.killed != self.musts):
            return ExitCode.NOT_CONFORMANT
        return ExitCode.INDETERMINATE if self.unexpected else ExitCode.CONFORMANT

    def as_document(self) -> dict[str, Any]:
        """Return everything as JSON can have it."""
        return {
            "defects": [_entry(one) for one in self.outcomes],
            "totals": {
                "run": len(self.outcomes),
                "noticed_as_expected": len(self.noticed),
                "of_these_warnings_only": len(self.warned),
                "declared": len(self.declared.defects),
                "catalogue": self.declared.total,
                "catalogue_noticed": len(self.shown),
                "catalogue_covered": len(self.covered),
                "musts_with_a_check": len(self.musts),
                "musts_killed": len(self.killed),
            },
            "unexpected": [one.defect.id for one in self.unexpected],
            "musts_not_killed": sorted(self.musts - self.killed),
            "musts_without_a_check": self.unjudged,
            "not_noticed_yet": [
                {"id": one.id, "sentence": one.sentence, "needs": one.reason} for one in self.declared.unnoticed
            ],
            "exit_code": int(self.exit_code),
        }


def _entry(one: Outcome) -> dict[str, Any]:
    return {
        "id": one.defect.id,
        "protocol": one.defect.protocol,
        "sentence": one.defect.sentence,
        "as_expected": one.is_expected,
        "expected": {"items": list(one.defect.items), "requirements": list(one.defect.requirements)},
        "seen": {"items": sorted(one.seen.items), "requirements": sorted(one.seen.requirements)},
        "faults": list(one.seen.faults),
        "findings": list(one.seen.words),
        "seconds": round(one.seconds, 3),
    }
