"""Oracles that need nothing of a protocol but the contract of journal entries and images. Pure.

A protocol makes one :class:`Witness` with its own words and uses it for the checks that are the same for every protocol:
exactly one request, nothing that changes the plant, only these points changed. Checks of its own fields stay in its own
oracles.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from ..core.finding import Finding
from ..core.strict_json import same_json
from .journal import Entries, Image, JournalEntry
from .session_oracle import StateChanges

__all__ = ["Witness", "has", "requests", "state_changing"]

_MOST_SHOWN = 8
_MOST_FINDINGS = 5


def has(entry: Mapping[str, object], **fields: object) -> bool:
    """Tell whether the entry has all these fields with these values."""
    return all(name in entry and entry[name] == value for name, value in fields.items())


def requests(entries: Entries, **fields: object) -> list[JournalEntry]:
    """Return the entries that ask the plant for something and have these fields."""
    return [entry for entry in entries if entry["request"] and has(entry, **fields)]


def state_changing(entries: Entries) -> list[JournalEntry]:
    """Return the requests that may change the plant."""
    return [entry for entry in entries if entry["state_changing"]]


def _any_equal(image: Image, point: str, held: object, wanted: object) -> bool:
    return same_json(held, wanted)


@dataclass(frozen=True, slots=True, kw_only=True)
class Witness:
    """Judge of journal slices and images in the words of one protocol.

    Attributes:
        noun: name of the device in sentences, such as ``the broker``.
        describe: describes a journal entry in a few words.
        holds_value: tells whether the value of an image's point is as good as the wanted one; for devices that round.
    """

    noun: str
    describe: Callable[[JournalEntry], str]
    holds_value: Callable[[Image, str, object, object], bool] = _any_equal

    def seen(self, entries: Entries) -> str:
        """Describe the requests among the entries, for a finding's evidence."""
        asked = requests(entries)
        shown = "; ".join(self.describe(entry) for entry in asked[:_MOST_SHOWN])
        return (shown or "no request") + (" …" if len(asked) > _MOST_SHOWN else "")

    def answered(self, entries: Entries, *, at_least: int = 1) -> list[Finding]:
        """Expect that the device answered so many requests at least; requests and answers are both among the entries."""
        asked = {entry["seq"] for entry in requests(entries)}
        count = sum(entry["answers"] in asked for entry in entries)
        if count >= at_least:
            return []
        problem = f"it answered {count} of {len(asked)}" if asked else "it saw none"
        return [
            Finding(
                code="no_exchange",
                message=f"{self.noun} should have answered at least {at_least} request(s) during the call(s), {problem}",
                requirement="RD-004",
                evidence=self.seen(entries),
            )
        ]

    def no_refusal(self, entries: Entries, wanted: str, sent: Sequence[str], *, requirement: str) -> list[Finding]:
        """Return the finding about an error of the protocol with which the device should have refused, and did not.

        Args:
            entries: in which a protocol has looked for the error.
            wanted: the error, as the device's manual writes it.
            sent: the errors that the device answered with.
            requirement: id of the requirement whose proof is missing.
        """
        return [
            Finding(
                code="no_refusal",
                message=f"{self.noun} should have refused with {wanted}, its answers had {', '.join(sent) or 'none'}",
                requirement=requirement,
                evidence=self.seen(entries),
            )
        ]

    def was_asked(self, entries: Entries, what: str, covers: Callable[[Sequence[JournalEntry]], bool]) -> list[Finding]:
        """Expect that the device was asked for something and answered.

        By how many requests is the adapter's own affair, as long as ``meta.attempts`` says so (requirement ENV-005).

        Args:
            what: words that follow "asked for".
            covers: tells whether these requests, all of which were answered, cover it.
        """
        answered = {entry["answers"] for entry in entries}
        if covers([entry for entry in requests(entries) if entry["seq"] in answered]):
            return []
        return [
            Finding(
                code="no_exchange",
                message=f"{self.noun} should have been asked for {what} during the call, it was not",
                requirement="RD-004",
                evidence=self.seen(entries),
            )
        ]

    def exactly_one_write(
        self, entries: Entries, what: str, problem_of: Callable[[JournalEntry], tuple[str, str] | None]
    ) -> list[Finding]:
        """Expect that exactly one request that may change the plant reached the device: the write that was asked for.

        Args:
            what: the write that was asked for, in words that follow "one".
            problem_of: returns the requirement and the words for the fault of a write; None when it has none.
        """
        writes = state_changing(entries)
        problem: tuple[str, str] | None
        if len(writes) == 1:
            problem = problem_of(writes[0])
        else:
            problem = "WR-003" if writes else "WR-001", f"it saw {len(writes)}"
        if problem is None:
            return []
        requirement, words = problem
        return [
            Finding(
                code="not_written_once",
                message=f"{self.noun} should have seen one {what}, {words}",
                requirement=requirement,
                evidence=self.seen(entries),
            )
        ]

    def nothing_changed(
        self, entries: Entries, *, requirement: str = "WR-004", commands: Callable[[JournalEntry], bool] | None = None
    ) -> list[Finding]:
        """Expect that no request that may change the plant reached the device.

        Args:
            requirement: id of the requirement that such a request breaks.
            commands: tells whether such a request commands the plant; only those that do count. None counts all.
        """
        found = [entry for entry in state_changing(entries) if commands is None or commands(entry)]
        return self._wrote(len(found), found, requirement)

    def nothing_changed_by(self, session: StateChanges) -> list[Finding]:
        """Expect that no request that may change the plant reached the device in the whole life of a session."""
        return self._wrote(session.count, session.first, "WR-004")

    def _wrote(self, count: int, first: Entries, requirement: str) -> list[Finding]:
        if not count:
            return []
        return [
            Finding(
                code="wrote",
                message=f"{self.noun} should have seen no state-changing request, it saw {count}",
                requirement=requirement,
                evidence=self.seen(first),
            )
        ]

    def no_duplicates(self, entries: Entries, *, identity: Callable[[JournalEntry], object]) -> list[Finding]:
        """Expect that no request that may change the plant reached the device twice.

        Args:
            identity: returns a key that is equal for requests that have the same effect.
        """
        counts = Counter(identity(entry) for entry in state_changing(entries))
        return [
            Finding(
                code="written_twice",
                message=f"{self.noun} should have seen each write once, it saw {what!r} {count} times",
                requirement="WR-003",
                evidence=self.seen(entries),
            )
            for what, count in counts.items()
            if count > 1
        ][:_MOST_FINDINGS]

    def holds(self, image: Image, expected: Mapping[str, object]) -> list[Finding]:
        """Expect that the device's points hold these values."""
        return self._differing(image, expected, dict.fromkeys(expected, "WR-001"))

    def only_changed(
        self, before: Image, after: Image, expected: Mapping[str, object], *, otherwise: str = "WR-002"
    ) -> list[Finding]:
        """Expect that these points got these values between two images; every other point is unchanged, and none is gone.

        Args:
            otherwise: id of the requirement that a change of another point breaks.
        """
        old = before["points"]
        points = {**dict.fromkeys(after["points"]), **old, **expected}
        requirements = {point: "WR-001" if point in expected else otherwise for point in points}
        return self._differing(after, points, requirements)

    def _differing(
        self, image: Image, expected: Mapping[str, object], requirements: Mapping[str, str]
    ) -> list[Finding]:
        findings = []
        held = image["points"]
        for point in sorted(expected):
            wanted = expected[point]
            if point in held and self.holds_value(image, point, held[point], wanted):
                continue
            shown = f"holds {held[point]!r}" if point in held else "has no such point"
            findings.append(
                Finding(
                    code="device_differs",
                    message=f"{point} should hold {wanted!r}, {self.noun} {shown}",
                    requirement=requirements[point],
                )
            )
        return findings[:_MOST_FINDINGS]
