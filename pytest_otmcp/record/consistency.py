"""Consistency of a run record: its identifiers and times must not contradict each other. Pure.

The checks take one sample at a time, so that a record of any length can be checked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime, timedelta

from ..core.challenge import is_nonce, seed_of
from ..core.matrix import FIELD, KNOWN_SUITES, REQUIREMENTS, repetitions
from ..core.verdict import INEXPRESSIBLE, UNBOUND, Status
from .schema import COUNTED, ROLES, Call, Counted, Footer, Header, Item, ItemHead, Sample, Settings

__all__ = [
    "Contradiction",
    "RunChecker",
    "clock_faults",
    "count_calls",
    "header_faults",
    "inapplicable_by_steps",
    "tool_calls",
]

_ROUNDING = timedelta(seconds=2)
"""Times of the run have whole seconds."""
_AHEAD = timedelta(hours=1)
"""So far may two clocks be apart."""
_MAIN = "main"
"""The worker of a run without pytest-xdist."""
_FIRST_STATELESS = "2026-07-28"
"""The first revision of MCP without ``initialize``: revisions are dates, and compare as text."""
_DRIFT = 0.001
"""Twice the rate at which a clock is slewed towards a time server, and a margin."""


class Contradiction(Exception):
    """A record contradicts itself; the message says where."""


_APART: Mapping[str, Counted] = {"recovery": "recovery", REQUIREMENTS: "check"}
"""Suites whose calls of the role ``task`` the paper's count of tool calls does not have, and what they are counted as."""


def tool_calls(suite: str, calls: Iterable[Call]) -> Counter[Counted]:
    """Count the tool calls of an item by role; ``task`` is the paper's count of tool calls."""
    task = _APART.get(suite, "task")
    return Counter(task if call["role"] == "task" else call["role"] for call in calls)


def count_calls(items: Iterable[Item]) -> dict[Counted, int]:
    """Count the tool calls of these items by role; of checks, where there are any."""
    calls: Counter[Counted] = Counter(dict.fromkeys(ROLES, 0))
    for item in items:
        for part in (*item["around"], *item["samples"]):
            calls.update(tool_calls(item["suite"], part["calls"]))
    return dict(calls)


def inapplicable_by_steps(item: ItemHead) -> bool:
    """Tell whether the steps of an item found nothing to judge: they ran, and playing them back shows the same."""
    may = item["suite"] in (REQUIREMENTS, FIELD) or (item["reason"] or "").startswith((*INEXPRESSIBLE, UNBOUND))
    return may and item["status"] == Status.NOT_APPLICABLE and bool(item["devices"])


class RunChecker:
    """The check of a record of the right shape, item by item."""

    def __init__(self, header: Header) -> None:
        self._header = header
        self._items: set[str] = set()
        self._samples = 0
        self._calls: Counter[Counted] = Counter()
        for moment in (header["environment"]["started_at"], header["environment"]["finished_at"]):
            _check_instant(moment, "the record")
        for suite in header["settings"]["suites"]:
            if suite not in KNOWN_SUITES:
                raise Contradiction(f"the settings ask for the unknown suite {suite!r}")
        _check_once(header["settings"]["suites"], "the settings ask for the suite")
        _check_once([entry["key"] for entry in header["kit"]["protocols"]], "the kit has the protocol")

    def item(self, item: ItemHead, samples: Iterable[Sample]) -> Iterator[Sample]:
        """Check an item while its samples pass through.

        Raises:
            Contradiction: the item contradicts itself or the run.
        """
        name = item["id"]
        self._check_head(item)
        for part in item["around"]:
            self._calls += tool_calls(item["suite"], part["calls"])
        count = 0
        for sample in samples:
            if sample["repetition"] != count or count >= item["planned"]:
                raise Contradiction(f"the repetitions of {name} are not the first of {item['planned']}")
            count += 1
            self._calls += tool_calls(item["suite"], sample["calls"])
            yield sample
        self._samples += count

    def _check_head(self, item: ItemHead) -> None:
        name = item["id"]
        if name in self._items:
            raise Contradiction(f"an item occurs twice: {name}")
        self._items.add(name)
        if item["suite"] not in KNOWN_SUITES:
            raise Contradiction(f"{name} has the unknown suite {item['suite']!r}")
        if item["suite"] not in self._header["settings"]["suites"]:
            raise Contradiction(f"{name} is of the suite {item['suite']}, which the settings do not ask for")
        if item["run_id"] != self._header["run_id"]:
            raise Contradiction(f"{name} is of another run: its run_id is {item['run_id']}")
        if item["ended_ns"] < item["began_ns"]:
            raise Contradiction(f"{name} ended before it began")
        for moment in (item["started_at"], item["finished_at"]):
            _check_instant(moment, name)
        # The header of a run that did not end does not know its devices yet.
        if self._header["environment"]["finished_at"] is None:
            return
        for at, device in item["devices"].items():
            known = self._header["devices"].get(device["device"])
            if known is not None and known["worker"] != item["worker"]:
                raise Contradiction(f"{name} was performed by {item['worker']}, its device {at} is {known['worker']}'s")
            if known is None:
                raise Contradiction(f"{name} has the device {device['device']!r} as {at}, the run has no such device")

    def counts(self) -> dict[str, object]:
        """Return what a footer counts: the items, their samples and their tool calls."""
        calls = {role: self._calls[role] for role in COUNTED if role in ROLES or self._calls[role]}
        return {"items": len(self._items), "samples": self._samples, "tool_calls": calls}

    def footer(self, footer: Footer) -> None:
        """Check the footer, after all items.

        Raises:
            Contradiction: it is called complete and is not.
        """
        if footer["complete"] and "digest" not in footer:
            raise Contradiction("a complete record without a digest")
        if footer["complete"] != (footer["reason"] is None):
            raise Contradiction("a record has a reason in its footer if, and only if, it is not complete")


def _check_once(names: Sequence[str], what: str) -> None:
    twice = next((name for name, number in Counter(names).items() if number > 1), None)
    if twice is not None:
        raise Contradiction(f"{what} {twice!r} twice")


def header_faults(header: Header, now: datetime) -> Iterator[str]:
    """Say in a sentence each what cannot be of a run, whatever its items.

    Args:
        now: the time at which the record is examined.
    """
    finished = header["environment"]["finished_at"]
    if finished is not None and _moment(finished) > now + _AHEAD:
        yield f"the run ended at {finished}, and now it is {now.isoformat(timespec='seconds')}"
    settings = header["settings"]
    for name, device in header["devices"].items():
        if (device["worker"] == _MAIN) != (settings["xdist_workers"] == 0):
            yield f"the settings say {settings['xdist_workers']} workers of pytest-xdist, {name} was {device['worker']}'s"
    for protocol, facts in header["subject"]["adapters"].items():
        revision = facts["protocol_version"]
        if settings["era"] == "legacy" and revision is not None and revision >= _FIRST_STATELESS:
            yield f"the settings ask for sessions by handshake, that of {protocol} was one of MCP {revision}"


def settings_faults(settings: Settings) -> Iterator[str]:
    """Say in a sentence what cannot be of the options of a run."""
    follows = repetitions(settings["reps"]) if settings["reps"] else {}
    challenge = settings.get("challenge")
    if challenge is not None and (not is_nonce(challenge) or settings["seed"] != seed_of(challenge)):
        yield f"the seed {settings['seed']} does not follow from the challenge {challenge[:128]!a}"
    if settings["repetitions"] != follows:
        yield f"of N = {settings['reps']} follow the repetitions {follows}, the settings say {settings['repetitions']}"


def clock_faults(header: Header, items: Iterable[ItemHead]) -> Iterator[str]:
    """Name the items whose time of day is not of the run, or does not go with their monotonic time, in a sentence each.

    In a run whose machine is given another time of day meanwhile they do not go together either: nobody can tell when it was.

    Args:
        header: of a record that has been checked.
        items: its items.
    """
    began, ended = header["environment"]["started_at"], header["environment"]["finished_at"]
    if ended is None:
        yield "the record does not say when the run ended"
        return
    first, last = _moment(began) - _ROUNDING, _moment(ended) + _ROUNDING
    reference: tuple[datetime, int] | None = None
    for item in sorted(items, key=lambda item: item["began_ns"]):
        for which, monotonic in (("started_at", item["began_ns"]), ("finished_at", item["ended_ns"])):
            stated = item["started_at"] if which == "started_at" else item["finished_at"]
            moment = _moment(stated)
            if not first <= moment <= last:
                yield f"{item['id']}: {which} {stated} is not within the run, which lasted from {began} to {ended}"
                break
            reference = reference or (moment, monotonic)
            shown = reference[0] + timedelta(microseconds=(monotonic - reference[1]) // 1000)
            if abs(moment - shown) > _ROUNDING + abs(shown - reference[0]) * _DRIFT:
                yield (
                    f"{item['id']}: {which} {stated} does not go with its monotonic time: it is of another run, or the clock "
                    "of the machine was set meanwhile"
                )
                break


def _moment(text: str) -> datetime:
    return datetime.fromisoformat(text)


def _check_instant(moment: str | None, where: str) -> None:
    if moment is None:
        return
    try:
        datetime.fromisoformat(moment)
    except ValueError:
        raise Contradiction(f"{where} has the time {moment!r}, which no clock shows") from None
