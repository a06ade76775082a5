"""A run record whose evidence stays and whose judgement is that of this kit: what ``otmcp judge`` prints is carried out."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pytest_otmcp import __version__
from pytest_otmcp.core.verdict import Status, decide
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record.reader import StoredRun
from pytest_otmcp.record.schema import Finding
from pytest_otmcp.replay.difference import MemberDiffers, Objection
from pytest_otmcp.replay.rejudge import differences
from pytest_otmcp.suite.catalogue import identity, kit_digest, suite_digest
from tests.stored_runs import store

__all__ = ["rejudged"]

_WHERE = re.compile(
    r"(?P<item>\S+)(?: repetition (?P<rep>\d+)| (?P<role>[a-z]+))?(?:, call (?P<call>\d+) \(.*\))?", re.DOTALL
)


def rejudged(run: StoredRun, path: Path) -> tuple[int, list[str]]:
    """Write a record with the evidence of another one and the judgement of this kit.

    Returns:
        The number of differences that were carried out, and the objections, for which the adapter has to be measured again; where there is
        one, nothing is written.
    """
    found = list(differences(run))
    objections = [str(one) for one in found if isinstance(one, Objection)]
    if objections:
        return 0, objections
    items: dict[str, Any] = {item.head["id"]: {**item.head, "samples": list(item.samples())} for item in run.items()}
    new: dict[str, list[Finding]] = {}
    gone: dict[str, list[Finding]] = {}
    for one in found:
        assert not isinstance(one, Objection)
        if isinstance(one, MemberDiffers):
            _part(items, one.where)[one.name] = one.shown
        else:
            (new if one.is_shown else gone).setdefault(one.where, []).append(one.finding)
    for where in {**new, **gone}:
        _replace(_findings(_part(items, where)), new.get(where, []), gone.get(where, []))
    kit = {
        **run.header["kit"],
        "version": __version__,
        "suite_digest": suite_digest(),
        "digest": kit_digest(),
        "protocols": [identity(protocols()[known["key"]]) for known in run.header["kit"]["protocols"]],
    }
    verdict = decide({name: Status(item["status"]) for name, item in items.items()}, items)
    footer = {**run.footer, "verdict": str(verdict)}
    store(path, {**run.header, "kit": kit, "items": list(items.values()), "footer": footer})
    return len(found), []


def _part(items: Mapping[str, Any], where: str) -> dict[str, Any]:
    place = _WHERE.fullmatch(where)
    assert place is not None, where
    part: dict[str, Any] = items[place["item"]]
    if place["rep"] is not None:
        part = next(sample for sample in part["samples"] if sample["repetition"] == int(place["rep"]) - 1)
    elif place["role"] is not None:
        part = next(around for around in part["around"] if around["role"] == place["role"])
    return part if place["call"] is None else part["calls"][int(place["call"]) - 1]


def _findings(part: dict[str, Any]) -> list[Any]:
    found: list[Any] = part["findings"] if "findings" in part else part["frames"]["faults"]
    return found


def _replace(findings: list[Any], new: Sequence[Finding], gone: Sequence[Finding]) -> None:
    """Put each new finding in the place of one that said the same in other words; the first of an item heads its cause."""
    left = list(new)
    for finding in gone:
        place = findings.index(finding)
        like = next(
            (one for one in left if (one["code"], one["requirement"]) == (finding["code"], finding["requirement"])),
            None,
        )
        findings[place : place + 1] = [] if like is None else [like]
        if like is not None:
            left.remove(like)
    findings += left
