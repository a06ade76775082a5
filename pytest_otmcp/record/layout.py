"""A record in its file and in memory. Pure.

In the file the evidence and the judgement of a repetition, an item or a call are apart, the latter as its member ``judgement``; what a
reader can derive by itself is not there at all. In memory they are together. Of messages in journals see ``journals``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypeVar, cast

from ..protocols.evidence import evidence
from .schema import (
    Around,
    Call,
    CallJudgement,
    Footer,
    ItemHead,
    ItemJudgement,
    Sample,
    SampleJudgement,
    ShapeError,
)

__all__ = [
    "COUNTED_BY_READERS",
    "DERIVED_OF_CALL",
    "USUAL_OF_CALL",
    "head_of",
    "kept_footer",
    "kept_head",
    "kept_sample",
    "sample_of",
]

DERIVED_OF_CALL = frozenset({"latency_ms", "error_code"})
"""Members of a call that a reader derives."""
USUAL_OF_CALL: Mapping[str, object] = {"variant": "rw", "native": True, "listed": True}
"""Members of a call that are in the file only where they are otherwise."""
COUNTED_BY_READERS = frozenset({"items", "samples", "tool_calls"})
"""Members of a footer that a reader counts."""

Part = TypeVar("Part", Sample, Around)


# -- to the file -----------------------------------------------------------------------------------------------------------


def kept_sample(sample: Sample) -> Mapping[str, Any]:
    """Return a repetition as the file has it."""
    return _apart(_kept_part(sample), SampleJudgement.__annotations__)


def kept_head(head: ItemHead) -> Mapping[str, Any]:
    """Return an item without its samples as the file has it."""
    devices = {
        at: {**found, **{name: _kept_entries(found[name]) for name in ("missed", "before") if name in found}}
        for at, found in head["devices"].items()
    }
    around = [_kept_part(part) for part in head["around"]]
    return _apart({**head, "devices": devices, "around": around}, ItemJudgement.__annotations__)


def kept_footer(footer: Footer) -> Mapping[str, Any]:
    """Return a footer as the file has it."""
    return {name: value for name, value in footer.items() if name not in COUNTED_BY_READERS}


def _kept_part(part: Sample | Around) -> Mapping[str, Any]:
    return {**part, "calls": [_kept_call(call) for call in part["calls"]], "device": _kept_entries(part["device"])}


def _kept_entries(entries: Iterable[Any]) -> list[Any]:
    return [evidence(entry) for entry in entries]


def _kept_call(call: Call) -> Mapping[str, Any]:
    judged = (*CallJudgement.__annotations__, *(["envelope"] if "frames" in call else []))
    usual = {name for name, value in USUAL_OF_CALL.items() if call.get(name) == value}
    kept = {name: value for name, value in call.items() if name not in DERIVED_OF_CALL | usual}
    return _apart(kept, judged)


def _apart(value: Mapping[str, Any], judged: Iterable[str]) -> Mapping[str, Any]:
    judgement = {name: value[name] for name in judged if name in value}
    return {**{name: one for name, one in value.items() if name not in judgement}, "judgement": judgement}


# -- from the file ---------------------------------------------------------------------------------------------------------


def sample_of(kept: Any, where: str) -> Sample:
    """Return a repetition of the file as it is in memory, but for its journals; its shape is to be checked.

    Raises:
        ShapeError: it has no judgement where one should be.
    """
    return cast(Sample, _part_of(_together(kept, where), where))


def head_of(kept: Any, where: str) -> ItemHead:
    """Return an item of the file as it is in memory; see :func:`sample_of`."""
    head = _together(kept, where)
    if isinstance(around := head.get("around"), list):
        head["around"] = [_part_of(part, where) for part in around]
    return cast(ItemHead, head)


def _part_of(part: Any, where: str) -> Any:
    if not isinstance(part, dict) or not isinstance(calls := part.get("calls"), list):
        return part
    return {**part, "calls": [_call_of(call, where) for call in calls]}


def _call_of(kept: Any, where: str) -> dict[str, Any]:
    call = {**USUAL_OF_CALL, **_together(kept, f"{where}: a call")}
    sent, received, envelope = call.get("sent_ns"), call.get("received_ns"), call.get("envelope")
    error = envelope.get("error") if isinstance(envelope, dict) else None
    code = error.get("code") if isinstance(error, dict) else None
    call["latency_ms"] = None
    if isinstance(sent, int) and isinstance(received, int):
        call["latency_ms"] = round((received - sent) / 1e6, 4)
    call["error_code"] = code if isinstance(code, str) else None
    return call


def _together(kept: Any, where: str) -> dict[str, Any]:
    judgement = kept.get("judgement") if isinstance(kept, dict) else None
    if not isinstance(judgement, dict):
        raise ShapeError(f"{where}: object missing required field `judgement`")
    return {**{name: value for name, value in kept.items() if name != "judgement"}, **judgement}
