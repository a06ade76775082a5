"""Causes of what a run found: one for each rule that an adapter does not keep, with the items that it touches. Pure.

One fault of an adapter turns many items red: a write that is never sent fails wherever something is written. Whoever reads a
report wants the fault first, and then how far it reaches.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

from ..core.finding_registry import finding_codes
from ..core.matrix import CROSS_PROTOCOL
from ..protocols.registry import protocols
from ..record.schema import Finding
from ..record.warnings import failing
from ..suite.by_library import advice
from ..suite.requirements import requirements
from . import Item, Run

__all__ = ["Cause", "causes", "extent"]

_ROLE = re.compile(r"^(?:setup|warmup|control): ")
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
        first: the first finding, in the order of the suite.
        where: its item.
        repetition: number of its repetition, from 0; None when it was found outside of the repetitions.
        items: ids of the items that it touches, in the order of the suite.
        times: number of findings.
        alone: how many of these items have no other finding.
        further: the first sentence of each other kind of finding about the same rule.
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
    by_library: tuple[str, ...] = ()


def extent(cause: Cause) -> str:
    """Say how many items have no other finding, of a fault that is about the session and therefore in many; empty for any other."""
    known = finding_codes().get(cause.first["code"])
    if known is None or not known.beside or len(cause.items) < _SEVERAL:
        return ""
    return f"{cause.alone} of {len(cause.items)} items have no other finding"


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
    adapters = run["subject"]["adapters"].items()
    return {known[key].name: facts.get("libraries", {}) for key, facts in adapters if key in known}


def _findings(items: Iterable[Item]) -> Iterator[_Found]:
    place = 0
    for item in items:
        around = ((None, finding) for finding in failing(item["findings"]))
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
    first = group[0]
    kinds = {one.kind: one for one in reversed(group)}
    further = sorted((one for kind, one in kinds.items() if kind != first.kind), key=lambda one: one.place)
    return Cause(
        family=family,
        rule=first.rule,
        statement=row.statement if (row := requirements().get(first.rule)) is not None else "",
        first=first.finding,
        where=first.item,
        repetition=first.repetition,
        items=tuple(dict.fromkeys(one.item["id"] for one in group)),
        times=len(group),
        alone=sum(len(kinds_of[one]) == 1 for one in {one.item["id"] for one in group}),
        further=tuple(_ROLE.sub("", one.finding["message"]) for one in further),
        by_library=tuple(advice(first.rule, used)),
    )
