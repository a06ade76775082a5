"""Places in a run record that forgeries change."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

__all__ = ["Change", "Record", "call", "calls", "entry", "facts", "item", "journal", "look", "moved", "parts", "sample"]

Record = dict[str, Any]
Change = Callable[[Record], object]


def item(run: Record, identifier: str) -> Record:
    return next(entry for entry in run["items"] if entry["id"] == identifier)


def sample(run: Record, identifier: str, number: int = 0) -> Record:
    found: Record = item(run, identifier)["samples"][number]
    return found


def call(run: Record, identifier: str, number: int = 0) -> Record:
    found: Record = sample(run, identifier)["calls"][number]
    return found


def journal(run: Record, identifier: str) -> list[Record]:
    found: list[Record] = sample(run, identifier)["device"]
    return found


def entry(run: Record, identifier: str, **members: Any) -> Record:
    """Return the first entry of an item's journals with these members, in whichever part."""
    parts = (*item(run, identifier)["around"], *item(run, identifier)["samples"])
    entries = (one for part in parts for one in part["device"])
    return next(one for one in entries if all(one.get(name) == value for name, value in members.items()))


def look(run: Record, identifier: str, what: str) -> Record:
    found: Record = next(seen for seen in sample(run, identifier)["observations"] if what in seen)
    return found


def facts(run: Record, protocol: str = "modbus") -> Record:
    found: Record = run["subject"]["adapters"][protocol]
    return found


def parts(run: Record) -> Iterator[Record]:
    for one in run["items"]:
        yield from one["around"]
        yield from one["samples"]


def calls(run: Record) -> Iterator[Record]:
    for part in parts(run):
        yield from part["calls"]


def moved(part: Record, *, seq: int = 0, ns: int = 0) -> None:
    """Move an item, or a repetition, in journal and time, as a forger would who is careful within it."""
    for found in part.get("devices", {}).values():
        found["begin"] += seq
        for name in ("asked_ns", "seen_ns", "accepting_ns"):
            found[name] += ns
        for one in found["before"]:
            one["t_ns"] += ns
    for name in {"began_ns", "ended_ns"} & part.keys():
        part[name] += ns
    for inner in [*part.get("around", []), *part.get("samples", [part])]:
        for one in inner["calls"]:
            for name in ("sent_ns", "received_ns"):
                one[name] += ns
        for one in inner["device"]:
            one["seq"] += seq
            one["t_ns"] += ns
            if one["answers"] is not None:
                one["answers"] += seq
        for seen in inner["observations"]:
            for name in ("asked_ns", "seen_ns"):
                seen[name] += ns
            for name in {"journal", "end", "followed"} & seen.keys():
                seen[name] += seq
            if "start" in seen:
                seen["start"]["accepting_ns"] += ns
            if "fresh_session" in seen:
                seen["fresh_session"]["spawned_ns"] += ns
