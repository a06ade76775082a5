"""A run record whose evidence stays and whose judgement is that of this kit: what ``otmcp judge`` prints is carried out."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from pytest_otmcp import __version__
from pytest_otmcp.core.verdict import Status, decide
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record.reader import StoredRun
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
    for one in found:
        assert not isinstance(one, Objection)
        place = _WHERE.fullmatch(one.where)
        assert place is not None, one.where
        part = _part(items[place["item"]], place)
        if isinstance(one, MemberDiffers):
            part[one.name] = one.shown
        elif one.is_shown:
            _findings(part).append(one.finding)
        else:
            _findings(part).remove(one.finding)
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


def _part(item: dict[str, Any], place: re.Match[str]) -> dict[str, Any]:
    part = item
    if place["rep"] is not None:
        part = next(sample for sample in item["samples"] if sample["repetition"] == int(place["rep"]) - 1)
    elif place["role"] is not None:
        part = next(around for around in item["around"] if around["role"] == place["role"])
    return part if place["call"] is None else part["calls"][int(place["call"]) - 1]


def _findings(part: dict[str, Any]) -> list[Any]:
    found: list[Any] = part["findings"] if "findings" in part else part["frames"]["faults"]
    return found
