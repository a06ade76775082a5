"""Causes of what a run found: one for each rule that an adapter does not keep, with the items that it touches. Pure.

One fault of an adapter turns many items red: a write that is never sent fails wherever something is written. Whoever reads a
report wants the fault first, and then how far it reaches.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

from ..core.finding_registry import finding_codes
from ..core.library_registry import libraries
from ..core.matrix import CROSS_PROTOCOL, REQUIREMENTS
from ..protocols.registry import protocols
from ..record.schema import Finding
from ..record.warnings import failing
from ..suite.by_library import advice
from ..suite.explanations import findings
from ..suite.requirements import requirements
from . import Item, Run
from .plainly import InWords, due, in_words

__all__ = ["Cause", "causes", "extent", "remedy", "rows", "without_cause"]

_ROLE = re.compile(r"^(setup|warmup|control): ")
_VARIABLE = re.compile(r"""'(?:[^'\\]|\\.){0,1000}'|"(?:[^"\\]|\\.){0,1000}"|\[[^\]]{0,1000}\]|\d+(?:\.\d+)?""")
"""What differs between findings of one fault in two items: values, addresses, texts, counts."""

_SEVERAL = 2
_COMPARED = 300
"""Characters of a sentence that say what its kind is; an adapter's own words behind them may have no end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """One rule that one adapter does not keep.

    Attributes:
        family: name of the adapter's protocol, or what items about several protocols are called.
        rule: id of the requirement, or the code of the findings where they cite none.
        statement: the rule in plain words; empty for one that is not in the catalogue.
        first: the finding that shows it best: the first of the benchmark or of the rule's own check, else the first.
        where: its item.
        repetition: number of its repetition, from 0; None when it was found outside of the repetitions.
        items: ids of the items that it touches, in the order of the suite.
        times: number of findings.
        alone: how many of these items have no other finding.
        further: the first sentence of each other kind of finding about the same rule.
        words: the call in which the first finding shows, in plain words; None without calls.
        due: what the adapter should have said; empty where the finding does not tell.
        by_library: what to change in the libraries that the adapter was seen to use, a sentence each.
    """

    family: str
    rule: str
    statement: str
    first: Finding
    where: Item
    repetition: int | None
    items: tuple[str, ...]
    times: int
    alone: int
    further: tuple[str, ...]
    words: InWords | None
    due: str
    by_rule: str = ""
    by_library: tuple[str, ...] = ()

    @property
    def headline(self) -> str:
        """The rule in plain words, or what the kind of finding means."""
        known = findings().get(self.first["code"])
        return self.statement or ("" if known is None else known[0].meaning)

    @property
    def changes(self) -> tuple[str, ...]:
        """What to change: for such a rule and in the libraries that the adapter was seen to use, else where the cause of such a finding usually is."""
        by_rule = (self.by_rule,) if self.by_rule else ()
        usual = remedy(None, self.first["code"])
        return by_rule + self.by_library or ((usual,) if usual else ())


def remedy(rule: str | None, code: str) -> str:
    """Say what to change: for a rule, else where the cause of a finding with such a code usually is; empty where nothing is known."""
    row, known = requirements().get(rule or ""), findings().get(code)
    return row.change if row is not None and row.change else "" if known is None else known[0].change


def extent(cause: Cause) -> str:
    """Say how many items have no other finding, of a fault that is about the session and therefore in many; empty for any other."""
    known = finding_codes().get(cause.first["code"])
    if known is None or not known.beside or len(cause.items) < _SEVERAL:
        return ""
    return f"{cause.alone} of {len(cause.items)} items have no other finding"


def rows(cause: Cause) -> list[tuple[str, tuple[str, ...]]]:
    """Return what was asked, said, seen and due, as far as the record tells, each with its label."""
    told = []
    if (words := cause.words) is not None:
        more = (f"and {words.more_seen} more",) if words.more_seen else ()
        told = [("asked", (words.asked,)), ("the adapter said", (words.said,)), ("the device saw", words.seen + more)]
        told += [("the device answered", (words.answered,))] if words.answered else []
    return [*told, *([("should have said", (cause.due,))] if cause.due else [])]


def without_cause(run: Run) -> list[Item]:
    """Return the items that did not pass and that no cause explains."""
    explained = {name for cause in causes(run) for name in cause.items}
    return [
        item
        for item in run["items"]
        if item["status"] not in ("PASS", "NOT_APPLICABLE") and item["id"] not in explained
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """A finding and its place."""

    finding: Finding
    item: Item
    place: int
    repetition: int | None

    @property
    def rule(self) -> str:
        """Id of the requirement, or else the kind of finding."""
        return self.finding["requirement"] or self.finding["code"]

    @property
    def kind(self) -> str:
        """The sentence without what differs from repetition to repetition."""
        return _VARIABLE.sub("#", _ROLE.sub("", self.finding["message"])[:_COMPARED])


def causes(run: Run) -> list[Cause]:
    """Return the causes of all findings about a MUST, in the order of the suite.

    A finding of an item about several protocols does not say whose fault it is. It belongs to the cause that has the same
    words in an item about one protocol, else to the only cause of the same rule, else to a cause of its own.
    """
    found = list(_findings(run["items"]))
    groups: dict[tuple[str, str], list[_Found]] = {}
    for one in found:
        if one.item["family"] != CROSS_PROTOCOL:
            groups.setdefault((one.item["family"], one.rule), []).append(one)
    kinds = {key: {one.kind for one in group} for key, group in groups.items()}
    for one in found:
        if one.item["family"] == CROSS_PROTOCOL:
            groups.setdefault(_of_cross_protocol(one, kinds), []).append(one)
    for group in groups.values():
        group.sort(key=lambda one: one.place)
    ordered = sorted(groups.items(), key=lambda entry: entry[1][0].place)
    used = _libraries(run)
    rules: dict[str, set[str]] = {}
    for one in found:
        rules.setdefault(one.item["id"], set()).add(one.rule)
    return [_cause(family, group, used.get(family, ()), rules) for (family, _), group in ordered]


def _libraries(run: Run) -> dict[str, Collection[str]]:
    """Return the libraries that adapters were seen to use, by the name of their protocol."""
    known = protocols()
    # A server of several protocols imports the libraries of all.
    return {
        known[key].name: facts.get("libraries", {}).keys() & {*libraries(), *libraries(known[key].package)}
        for key, facts in run["subject"]["adapters"].items()
        if key in known
    }


def _findings(items: Iterable[Item]) -> Iterator[_Found]:
    place = 0
    for item in items:
        # That an item was given up says no more than the missing replies before it.
        around = ((None, finding) for finding in failing(item["findings"]) if finding["code"] != "gave_up")
        within = (
            (sample["repetition"], finding) for sample in item["samples"] for finding in failing(sample["findings"])
        )
        for repetition, finding in (*within, *around):
            yield _Found(finding=finding, item=item, place=place, repetition=repetition)
            place += 1


def _of_cross_protocol(one: _Found, kinds: Mapping[tuple[str, str], Collection[str]]) -> tuple[str, str]:
    same_rule = [key for key in kinds if key[1] == one.rule]
    same_words = [key for key in same_rule if one.kind in kinds[key]]
    candidates = same_words or same_rule
    return candidates[0] if len(candidates) == 1 else (CROSS_PROTOCOL, one.rule)


def _cause(family: str, group: list[_Found], used: Collection[str], kinds_of: Mapping[str, Collection[str]]) -> Cause:
    first = _plainest(group)
    kinds = {one.kind: one for one in reversed(group)}
    further = sorted((one for kind, one in kinds.items() if kind != first.kind), key=lambda one: one.place)
    row = requirements().get(first.rule)
    return Cause(
        family=family,
        rule=first.rule,
        statement="" if row is None else row.statement,
        first=first.finding,
        where=first.item,
        repetition=first.repetition,
        items=tuple(dict.fromkeys(one.item["id"] for one in group)),
        times=len(group),
        alone=sum(len(kinds_of[one]) == 1 for one in {one.item["id"] for one in group}),
        further=tuple(_ROLE.sub("", one.finding["message"]) for one in further),
        words=_words(first),
        due=due(first.finding),
        by_rule="" if row is None else row.change,
        by_library=tuple(advice(first.rule, used, first.finding["code"])),
    )


def _plainest(group: list[_Found]) -> _Found:
    """Return the finding that shows a fault best: one of the benchmark, or of the check of the rule itself. Other checks meet it on their way."""
    return next(
        (one for one in group if one.item["suite"] != REQUIREMENTS or one.item["id"].startswith(f"{one.rule}.")),
        group[0],
    )


def _words(found: _Found) -> InWords | None:
    message, code = _ROLE.sub("", found.finding["message"]), found.finding["code"]
    evidence, role = found.finding["evidence"], _ROLE.match(found.finding["message"])
    if found.repetition is not None:
        sample = next(one for one in found.item["samples"] if one["repetition"] == found.repetition)
        return in_words(sample["calls"], sample["device"], message, code, evidence)
    # Calls around the repetitions have frames where something was wrong.
    calls = [call for part in found.item["around"] for call in part["calls"] if "frames" in call]
    if role is not None:
        calls = [call for call in calls if call["role"] == role[1]] or calls
    entries = [entry for part in found.item["around"] for entry in part["device"]]
    return in_words(calls, entries, message, code, evidence)
