"""Which packets of a broker's journal are the adapter's, and how findings show them. Pure."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["Entries", "Entry", "adapter_packets", "describe", "payload_of", "shown"]

Entry = Mapping[str, Any]
Entries = Sequence[Entry]

MOCK_CLIENTS = "otmcp-mock-"
"""The simulator's own clients; like what the kit itself published (connection 0), none of the adapter's doing."""


def adapter_packets(
    entries: Entries, kind: str | None = None, direction: str | None = None, client_id: str | None = None
) -> list[Entry]:
    """The entries of the adapter's connections, by kind and direction; ``client_id`` chooses one client."""
    return [
        entry
        for entry in entries
        if entry["connection"] != 0
        and kind in (None, entry["kind"])
        and direction in (None, entry["direction"])
        and _is_adapter(str(entry.get("client_id") or ""), client_id)
    ]


def _is_adapter(name: str, client_id: str | None) -> bool:
    return not name.startswith(MOCK_CLIENTS) if client_id is None else name == client_id


def payload_of(entry: Entry) -> bytes:
    """The message of a PUBLISH or of a will."""
    return base64.b64decode(entry.get("payload") or "")


def shown(entries: Entries, limit: int = 10) -> str:
    """The packets, for a finding's evidence: ``<`` from the adapter, ``>`` to it."""
    packets = [describe(entry) for entry in adapter_packets(entries)]
    if not packets:
        return "no packet"
    return "; ".join(packets[:limit]) + (f"; … {len(packets) - limit} more" if len(packets) > limit else "")


def describe(entry: Entry) -> str:
    """Describe a packet in a few words: ``<`` for one from a client, ``>`` for one to it."""
    text = f"{'<' if entry['direction'] == 'in' else '>'} {entry['kind']}"
    if entry["kind"] == "PUBLISH":
        text += f" {entry['topic']!r} QoS {entry.get('qos')}{' retained' if entry.get('retain') else ''}"
        text += f" {payload_of(entry)[:60]!r}"
    elif entry["kind"] in ("SUBSCRIBE", "UNSUBSCRIBE"):
        text += f" {[wanted.get('filter') for wanted in entry.get('filters') or []]}"
    elif entry.get("reason_codes"):
        text += f" {entry['reason_codes']}"
    elif entry.get("reason"):
        text += f" ({entry['reason']})"
    return text
