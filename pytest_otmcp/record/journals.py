"""The journals in a record: their evidence in the file, and the entries that a reader is given. Pure.

Messages are read with those before them, from the beginning of their connection, which may be of an earlier item. So a reader notes
where each device's journal had come to when an item began.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, TypeVar, cast

from ..protocols.evidence import JournalReader
from ..protocols.registry import protocols
from .schema import Around, ItemDevice, ItemHead, Sample

__all__ = ["AFTER_SAMPLES", "Journals"]

AFTER_SAMPLES = "control"
"""Role of the part of an item that comes after its repetitions."""

Part = TypeVar("Part", Sample, Around)


class Journals:
    """The journals of a run's devices, as far as they were read."""

    def __init__(self) -> None:
        self._of: dict[str, JournalReader] = {}

    def copy(self, head: ItemHead) -> Journals:
        """Return the journals of an item's devices as they are now: reading goes on in either."""
        made = Journals()
        names = {found["device"] for found in head["devices"].values()}
        made._of = {name: copy.deepcopy(self._of[name]) for name in names & self._of.keys()}
        return made

    def begin(self, head: ItemHead) -> ItemHead:
        """Read what an item has from before its repetitions; what it has from after them stays as it is."""
        devices: dict[str, ItemDevice] = {}
        for at, found in head["devices"].items():
            reader = self._reader(head, at)
            read = {name: [*map(reader.read, found[name])] for name in ("missed", "before") if name in found}
            devices[at] = cast(ItemDevice, {**found, **read})
        around = [part if part["role"] == AFTER_SAMPLES else self.part(head, part) for part in head["around"]]
        return {**head, "devices": devices, "around": around}

    def end(self, head: ItemHead) -> ItemHead:
        """Read what an item has from after its repetitions."""
        around = [self.part(head, part) if part["role"] == AFTER_SAMPLES else part for part in head["around"]]
        return {**head, "around": around}

    def part(self, head: ItemHead, part: Part) -> Part:
        """Read a repetition of an item, or another part."""
        entries = [self._reader(head, _at(entry)).read(entry) for entry in part["device"]]
        return cast(Part, {**part, "device": entries})

    def _reader(self, head: ItemHead, at: str) -> JournalReader:
        found = head["devices"].get(at)
        name = at if found is None else found["device"]
        if name not in self._of:
            protocol = protocols().get(at.partition("@")[0])
            framing = None if protocol is None else protocol.framing
            self._of[name] = JournalReader(None if framing is None else framing.conversation)
        return self._of[name]


def _at(entry: Mapping[str, Any]) -> str:
    variant = entry.get("variant")
    return str(entry["protocol"]) if variant is None else f"{entry['protocol']}@{variant}"
