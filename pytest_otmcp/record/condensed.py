"""A run record as reports and certificates need it: in memory, but not every call of every repetition. Pure.

Every sample keeps what is counted (``ok``, duration, phases, findings, and of each call ``ok``, its role and error code, and the
frames that nobody can read again). The first sample of an item, and the first of each kind of failure, are kept whole: reports show them.
"""

from __future__ import annotations

from typing import cast

from .reader import StoredItem, StoredRun
from .schema import Call, Item, Run, Sample
from .unread import is_unread

__all__ = ["condensed"]

_KINDS_KEPT = 10
"""Kinds of failure of one item whose first sample is kept whole."""


def condensed(run: StoredRun) -> Run:
    """Return the run; only the samples that reports show are whole."""
    shared: dict[tuple[object, ...], Call] = {}
    items = [_item(item, shared) for item in run.items()]
    return cast(Run, {**run.header, "items": items, "footer": run.footer})


def _item(item: StoredItem, shared: dict[tuple[object, ...], Call]) -> Item:
    kinds: set[tuple[str, ...]] = set()
    samples = []
    for sample in item.samples():
        kind = tuple(sorted({f"{finding['code']} {finding['requirement']}" for finding in sample["findings"]}))
        if kind in kinds or len(kinds) > _KINDS_KEPT:
            samples.append(_thin(sample, shared))
        else:
            kinds.add(kind)
            samples.append(sample)
    return cast(Item, {**item.head, "samples": samples})


def _thin(sample: Sample, shared: dict[tuple[object, ...], Call]) -> Sample:
    calls = []
    for call in sample["calls"]:
        if is_unread(call):
            # It is counted.
            kept = ("role", "error_code", "ok", "frames", "frames_sha256")
            calls.append(cast(Call, {name: value for name, value in call.items() if name in kept}))
            continue
        # Thousands of calls have the same counted members, so they share one object.
        told = (call["role"], call["error_code"], call["ok"])
        calls.append(shared.setdefault(told, cast(Call, dict(zip(("role", "error_code", "ok"), told, strict=True)))))
    return {**sample, "calls": calls, "device": [], "observations": []}
