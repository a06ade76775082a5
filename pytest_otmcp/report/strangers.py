"""Who else was at the devices of a run, in sentences: what others did was left out of the judgement. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..core.text import counted
from . import Run

__all__ = ["strangers"]

_ITEMS = 5
_SENT = 3


@dataclass(slots=True)
class _Found:
    items: list[str] = field(default_factory=list)
    connections: int = 0
    sent: dict[str, None] = field(default_factory=dict)


def strangers(run: Run) -> list[str]:
    """Return a sentence on each program that was at a device and is not the adapter under test."""
    found: dict[tuple[str, str, str | None], _Found] = {}
    for item in run["items"]:
        for one in item.get("strangers", ()):
            group = found.setdefault((one["at"], one["origin"], one["program"]), _Found())
            group.items.append(item["id"])
            group.connections += one["connections"]
            group.sent |= dict.fromkeys(one["sent"])
    return [_sentence(*key, group) for key, group in found.items()]


def _sentence(at: str, origin: str, program: str | None, found: _Found) -> str:
    where = ", ".join(found.items[:_ITEMS]) + (f" and {len(found.items) - _ITEMS} more" if found.items[_ITEMS:] else "")
    sent = "; ".join([*found.sent][:_SENT]) or "nothing"
    if origin == "former":
        return f"a process of a session that was over ({program}) still spoke to the device of {at} in {where}: {sent}; ignored"
    # A client that closes its end before the device accepts the connection leaves no process behind that could be asked for: an adapter
    # that gives up while it connects does that as well as a program that scans ports.
    who = (
        f"a stranger ({program})"
        if program is not None
        else "an unidentified client (gone before its process could be identified)"
    )
    return f"{who} connected to the device of {at} {counted(found.connections, 'time')} in {where} and sent {sent}; ignored"
