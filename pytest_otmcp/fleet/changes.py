"""What a fleet says that an earlier one did not: what broke, was mended, is new, is gone, or went otherwise with the same key. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from ..report.markdown import escape
from .lines import Line
from .outcome import Outcome

__all__ = ["Changes", "changes"]

_FAILED = (Outcome.NOT_CONFORMANT, Outcome.DID_NOT_START)
_CARRIED_OUT = (Outcome.CONFORMANT, *_FAILED)
_SAYS_NOTHING = {Outcome.FAULT, Outcome.NOT_RUN}
"""Outcomes that are none of the adapter's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Changes:
    """Lines that differ from the earlier fleet, a sentence each.

    Attributes:
        broke: was conformant, and fails; also a new version whose forerunner was conformant.
        unsteady: of the same kit, subject and environment, and another outcome; or tried more than once.
        without: neither conformant nor failed.
    """

    broke: dict[tuple[str, str], str] = field(default_factory=dict)
    mended: list[str] = field(default_factory=list)
    levels: list[str] = field(default_factory=list)
    new: list[str] = field(default_factory=list)
    gone: list[str] = field(default_factory=list)
    unsteady: list[str] = field(default_factory=list)
    without: list[str] = field(default_factory=list)

    def markdown(self, *, compared: bool) -> str:
        """Return ``changes.md``."""
        parts = [
            ("Broke", list(self.broke.values())),
            ("Mended", self.mended),
            ("Other levels", self.levels),
            ("New", self.new),
            ("Gone", self.gone),
            ("Unsteady", self.unsteady),
            ("Without a full verdict", self.without),
        ]
        text = ["# What has changed", ""]
        if not compared:
            text += ["There is no earlier fleet to compare with.", ""]
        for title, sentences in parts:
            if sentences:
                text += [f"## {title}", "", *(f"- {escape(sentence)}" for sentence in sentences), ""]
        if compared and not any(sentences for _, sentences in parts):
            text += ["Nothing.", ""]
        return "\n".join(text)


def changes(now: Sequence[Line], before: Iterable[Line] | None) -> Changes:
    """Compare the lines of a fleet with those of an earlier one; None when there was none."""
    found = Changes()
    for one in now:
        name = f"{one.id} {one.version}"
        if one.tries > 1:
            found.unsteady.append(f"{name}: {one.tries} tries, then {_said(one)}")
        if one.outcome not in _CARRIED_OUT:
            found.without.append(f"{name}: {_said(one)}")
    if before is None:
        return found
    earlier = {(line.id, line.version): line for line in before}
    kept = {one.id for one in now if (one.id, one.version) in earlier}
    # Versions stand from old to new, so a forerunner stands before; an adapter of which no version was kept was replaced.
    forerunners = {line.id: line for line in earlier.values() if line.id not in kept}
    for one in now:
        name, was = f"{one.id} {one.version}", earlier.pop((one.id, one.version), None)
        if was is None:
            forerunner = forerunners.get(one.id)
            found.new.append(f"{name}: {_said(one)}")
            if forerunner is not None and forerunner.outcome is Outcome.CONFORMANT and one.outcome in _FAILED:
                found.broke[one.id, one.version] = f"{name}: {_said(one)}; {forerunner.version} was conformant"
            continue
        forerunners[one.id] = was
        if was.outcome is Outcome.CONFORMANT and one.outcome in _FAILED:
            found.broke[one.id, one.version] = f"{name}: was conformant, now {_said(one)}"
        elif one.outcome is Outcome.CONFORMANT and was.outcome in _FAILED:
            found.mended.append(f"{name}: was {was.outcome}, now conformant")
        # A run that was given by itself has no key.
        same = one.key is not None and one.key == was.key
        if same and one.outcome is not was.outcome and not _SAYS_NOTHING & {one.outcome, was.outcome}:
            found.unsteady.append(
                f"{name}: {was.outcome} before, {one.outcome} now, with the same kit, subject and environment"
            )
        for protocol, cell in one.cells.items():
            level = was.cells[protocol].level if protocol in was.cells else cell.level
            if level != cell.level:
                found.levels.append(f"{name}, {protocol}: {level or 'no level'} before, {cell.level or 'no level'} now")
    found.gone.extend(f"{line.id} {line.version}" for line in earlier.values())
    return found


def _said(one: Line) -> str:
    if one.reason:
        return f"{one.outcome}: {one.reason}"
    return f"{one.outcome}: {', '.join(one.causes)}" if one.causes else str(one.outcome)
