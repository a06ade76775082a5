"""The level of conformance that an adapter has earned, for each protocol. Pure: a function of the catalogue and a run's items.

The rules of this file:

1. A level needs every MUST that the catalogue has for it and the levels below, in the profiles of every adapter and of the
   protocol. A row is met when its item of the requirement suite passed and no finding of any item is about it. It is violated when a
   finding of any item is about it. An item that failed for what was seen of its sessions beside its steps alone, such as a line on
   standard output, has shown its own row all the same: one fault is counted once.
2. A row whose item does not apply, because the subject does not claim what the row is about, is not asked for. A row without
   an item, or whose item did not end, or failed for what another row is about, is not shown: it denies the level as well.
3. A level is about something: at least one of the rows that begin with it and belong to the protocol's own profiles is met. The highest
   level is a whole: every MUST that begins with it is met, and none is only not asked for. The row about HTTP is for adapters that are
   reached by it, that about accounts for those that have one.
4. An adapter that may write has to show that its writes can be disabled, also where it does not claim that.
5. A failure that is about no row of the catalogue denies every level, and so does one of an item on this protocol alone that is about a
   row that the protocol does not have.
6. A row that is not yet judged is not asked for, but a finding about it counts. The highest level cannot be earned as long as
   rows that begin with it are not yet judged, nor over a protocol without a secure form.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from ..core.matrix import FIELD, REQUIREMENTS
from ..core.text import counted
from ..core.verdict import Status
from ..protocols.registry import protocols
from ..record.schema import AdapterFacts, Item
from ..record.warnings import failing, findings_of, passed_beside
from .requirements import Catalogue, Level, Requirement

__all__ = ["Standing", "in_words", "not_shown", "said", "shown", "standing", "standings"]

_NOT_ASKED = "none is shown without the requirement suite, and no permission to connect follows; otmcp certify runs it beside the benchmark"
_IN_FIELD = "none is shown by a field record, which is made at a real device, and it earns no certificate"

_NAMED = 5
"""Rows that a line names at most."""

_OVER_HTTP = "MCP-011"
"""The row about adapters that are reached over a network."""

_ACCOUNT = "SEC-003"
"""The row about adapters with an account at the device."""

_GUARD = "WR-004"
"""The row by which writes that are disabled stay disabled."""


class _State(StrEnum):
    """What the item of a row shows about it, the worst first."""

    OPEN = "open"
    MET = "met"
    UNCLAIMED = "unclaimed"


_STATES = {
    Status.PASS: _State.MET,
    # Which rules are broken is what the findings say.
    Status.FAIL: _State.OPEN,
    Status.NOT_TESTABLE: _State.OPEN,
    Status.NOT_APPLICABLE: _State.UNCLAIMED,
    Status.KIT_ERROR: _State.OPEN,
    Status.INTERRUPTED: _State.OPEN,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """The level of one protocol, and what is missing for the next one.

    Attributes:
        protocol: its key.
        level: the level that is earned; None for none.
        wanted: the next level.
        attainable: whether that level can be earned with this catalogue.
        failed: rows that it needs and that findings are about, each with the items that have them.
        unattributed: items with a failure that is about no row of the catalogue, or about none of the protocol's own.
        not_run: rows that it needs and that no item has decided.
        hidden: those of them whose item failed for another cause.
        unclaimed: rows that it would need of a subject that claims what they are about.
        not_yet: rows that it will need once they are judged.
        shown: whether a row of the protocol's own profiles that begins with that level is met; for the highest level, all rows that begin with it.
        absent: rows that begin with the highest level and are not asked for.
    """

    protocol: str
    level: Level | None
    wanted: Level
    attainable: bool
    failed: Mapping[str, tuple[str, ...]]
    unattributed: tuple[str, ...]
    not_run: tuple[str, ...]
    hidden: tuple[str, ...]
    unclaimed: tuple[str, ...]
    not_yet: tuple[str, ...]
    shown: bool
    absent: tuple[str, ...] = ()

    @property
    def secure(self) -> bool:
        """Whether the protocol has a secure form, without which the highest level cannot be earned."""
        return self.wanted is not Level.GOLD or protocols()[self.protocol].secure

    @property
    def earned(self) -> bool:
        """Whether the wanted level is earned."""
        return self.attainable and self.shown and not (self.failed or self.unattributed or self.not_run)


def standings(catalogue: Catalogue, items: Sequence[Item], adapters: Mapping[str, AdapterFacts]) -> list[Standing]:
    """Return the level of each protocol; of a run without items of the requirement suite, or at a real device, nothing is said about levels.

    Args:
        catalogue, items: as for :func:`standing`.
        adapters: those of the subject, by the key of the protocol.
    """
    suites = {item["suite"] for item in items}
    if REQUIREMENTS not in suites or FIELD in suites:
        return []
    return [
        standing(catalogue, items, protocol, over_http=facts.get("transport") == "http")
        for protocol, facts in adapters.items()
        if protocol in protocols()
    ]


def not_shown(items: Iterable[Item]) -> str:
    """Say why nothing is said about levels."""
    return _IN_FIELD if any(item["suite"] == FIELD for item in items) else _NOT_ASKED


def standing(catalogue: Catalogue, items: Sequence[Item], protocol: str, *, over_http: bool = False) -> Standing:
    """Return the level of one protocol.

    Args:
        catalogue: the requirement catalogue.
        items: of the run, in any order; those of other suites count by their findings.
        protocol: key of a protocol for which the subject has an adapter.
        over_http: the adapter is reached over a network.
    """
    evidence = _Evidence(catalogue, items, protocol, over_http=over_http)
    earned: Level | None = None
    for level in Level:
        found = evidence.standing(earned, level)
        if not found.earned:
            return found
        earned = level
    return replace(found, level=earned)


class _Evidence:
    """What the items of a run show about the rows, for one protocol."""

    def __init__(self, catalogue: Catalogue, items: Sequence[Item], protocol: str, *, over_http: bool) -> None:
        self._catalogue = catalogue
        self._protocol = protocol
        self._over_http = over_http
        self._states: dict[str, _State] = {}
        self._blamed: dict[str, list[str]] = {}
        self._hidden: set[str] = set()
        self._unattributed: list[str] = []
        self._rows = {row.id for row in catalogue.needs(Level.GOLD, protocol)}
        for item in items:
            if protocol in _protocols(item):
                self._look_at(item)

    def _look_at(self, item: Item) -> None:
        row, state = item["id"].partition(".")[0], _STATES[Status(item["status"])]
        failed = item["status"] in (Status.FAIL, Status.NOT_TESTABLE)
        cited = {finding["requirement"] for finding in failing(findings_of(item))}
        decides = item["suite"] == REQUIREMENTS and row in self._catalogue.rows
        if decides:
            if passed_beside(item):
                state, failed = _State.MET, False
            ranks = list(_State)
            self._states[row] = min(state, self._states.get(row, _State.UNCLAIMED), key=ranks.index)
            if failed:
                self._hidden.add(row)
        if item["status"] == Status.KIT_ERROR:
            # Nothing that was seen in it says anything about the adapter.
            return
        # What several protocols take part in may break a row of another one.
        known = self._rows if _protocols(item) == {self._protocol} else self._catalogue.rows.keys()
        for name in cited:
            if name in known:
                self._blame(str(name), item["id"])
            elif item["id"] not in self._unattributed:
                self._unattributed.append(item["id"])
        if failed and not cited and not decides:
            self._unattributed.append(item["id"])

    def _blame(self, row: str, item: str) -> None:
        if item not in (items := self._blamed.setdefault(row, [])):
            items.append(item)

    def standing(self, earned: Level | None, wanted: Level) -> Standing:
        """Return what is missing for a level above the one that is earned."""
        needed = [row for row in self._catalogue.needs(wanted, self._protocol) if row.strength == "MUST"]
        needed = [row for row in needed if self._over_http or row.id != _OVER_HTTP]
        judged = [row.id for row in needed if row.not_yet is None]
        failed = {row.id: tuple(sorted(self._blamed[row.id])) for row in needed if row.id in self._blamed}
        unclaimed = [name for name in judged if self._state(name) is _State.UNCLAIMED and name not in failed]
        not_run = [name for name in judged if self._state(name) is _State.OPEN and name not in failed]
        if _GUARD in unclaimed and not self._only_reads():
            unclaimed.remove(_GUARD)
            not_run.append(_GUARD)
        absent = [
            row.id for row in needed if row.level is wanted is Level.GOLD and row.id in unclaimed and row.id != _ACCOUNT
        ]
        return Standing(
            protocol=self._protocol,
            level=earned,
            wanted=wanted,
            attainable=wanted is not Level.GOLD
            or (
                protocols()[self._protocol].secure and all(row.not_yet is None for row in needed if row.level is wanted)
            ),
            failed=failed,
            unattributed=tuple(sorted(self._unattributed)),
            not_run=tuple(not_run),
            hidden=tuple(name for name in not_run if name in self._hidden),
            unclaimed=tuple(unclaimed),
            not_yet=tuple(row.id for row in needed if row.not_yet is not None and row.id not in failed),
            shown=not absent
            if wanted is Level.GOLD
            else any(self._state(row.id) is _State.MET and row.id not in failed for row in self._own(wanted)),
            absent=tuple(absent),
        )

    def _state(self, row: str) -> _State:
        return self._states.get(row, _State.OPEN)

    def _own(self, level: Level) -> list[Requirement]:
        """Return the rows that begin with a level and belong to a profile of the protocol's own."""
        return [
            row
            for row in self._catalogue.rows.values()
            if row.level is level
            and row.not_yet is None
            and any(self._catalogue.profiles[name].protocol == self._protocol for name in row.profiles)
        ]

    def _only_reads(self) -> bool:
        return all(self._state(row.id) is _State.UNCLAIMED for row in self._own(Level.SILVER))


def _protocols(item: Item) -> set[str]:
    """Return the keys of the protocols that an item is about; an item that does not say that is about every one."""
    known = set(protocols())
    if item["suite"] == REQUIREMENTS and (key := item["id"].partition(".")[2]) in known:
        return {key}
    named = {key for key in known if protocols()[key].name == item["family"]}
    return named or {name.partition("@")[0] for name in item["devices"]} & known or known


def in_words(found: Sequence[Standing]) -> str:
    """Say in a word or two which level each protocol has; empty for none that was looked at."""
    named = [(protocols()[one.protocol].name, _word(one)) for one in found]
    return named[0][1] if len(named) == 1 else ", ".join(" ".join(pair) for pair in named)


def _word(found: Standing) -> str:
    return "no level" if found.level is None else found.level.capitalize()


def said(found: Standing) -> str:
    """Say in one line which level a protocol has, and how far the next one is."""
    name = protocols()[found.protocol].name
    level = _word(found)
    if found.level is found.wanted:
        return f"{name}: {level}"
    if not found.attainable:
        return f"{name}: {level}; {found.wanted.capitalize()} cannot be earned{' yet' if found.secure else ''}"
    lacking = [
        f"{counted(len(names), noun)} {what} ({_some(names)})"
        for names, noun, what in (
            (tuple(found.failed), "row", "violated"),
            (found.unattributed, "item", "failed for what is no row of the protocol"),
            (found.not_run, "row", "not shown"),
            (found.absent, "row", "not asked for"),
        )
        if names
    ]
    if not lacking:
        lacking = ["nothing that belongs to it is claimed"]
    return f"{name}: {level}; for {found.wanted.capitalize()}: {'; '.join(lacking)}"


def _some(names: Sequence[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")


def shown(found: Standing, catalogue: Catalogue) -> list[str]:
    """Say what is missing for the next level in sentences, the rows by id with the items that show it."""
    wanted = found.wanted.capitalize()
    told = [f"{row} is violated, as {', '.join(items)} shows." for row, items in found.failed.items()]
    if found.unattributed:
        told.append(
            f"{', '.join(found.unattributed)} failed for a cause that is no row of the catalogue for this protocol."
        )
    if found.hidden:
        told.append(f"Not shown, because the item about it failed for another cause: {', '.join(found.hidden)}.")
    if unseen := [name for name in found.not_run if name not in found.hidden]:
        told.append(f"No item has shown {', '.join(unseen)}.")
    if found.absent:
        told.append(f"{wanted} needs every row that begins with it; not asked for: {', '.join(found.absent)}.")
    elif found.attainable and not found.shown:
        told.append(f"Nothing that {wanted} is about has been shown to work.")
    if found.unclaimed:
        told.append(f"Not asked for, because the subject does not claim it: {', '.join(found.unclaimed)}.")
    reasons: dict[str, list[str]] = {}
    for name in found.not_yet:
        reasons.setdefault(catalogue.rows[name].not_yet or "", []).append(name)
    told += [f"Not yet judged: {', '.join(names)} ({reason})." for reason, names in reasons.items()]
    if not found.secure:
        name = protocols()[found.protocol].name
        told.append(
            f"{wanted} cannot be earned: the kit knows no form of {name} in which device and adapter know each other."
        )
    elif not found.attainable:
        told.append(f"{wanted} cannot be earned yet: rows that begin with it are not yet judged.")
    return told
