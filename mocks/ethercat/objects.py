"""The object dictionary of a slave (ETG.1000.6, CiA 301): what is in it, who may read and write it, and the abort codes of a refusal."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

__all__ = ["Dictionary", "Entry", "common", "entry"]

NO_OBJECT, NO_SUBINDEX = 0x06020000, 0x06090011
WRITE_ONLY, READ_ONLY = 0x06010001, 0x06010002
TOO_LONG, TOO_SHORT = 0x06070012, 0x06070013
TOO_HIGH, TOO_LOW = 0x06090031, 0x06090032


@dataclass(slots=True, kw_only=True)
class Entry:
    """One value.

    Attributes:
        form: of :mod:`struct`; empty for a text, whose length is at most that of the first one.
        data: its bytes.
        access: ``ro``, ``rw`` or ``wo``.
        lowest, highest: bounds of a number.
    """

    form: str
    data: bytes
    access: str = "ro"
    lowest: float = -math.inf
    highest: float = math.inf

    @property
    def value(self) -> int | float | bool | str:
        """The value that the bytes stand for."""
        if not self.form:
            return self.data.rstrip(b"\0").decode("latin-1")
        (value,) = struct.unpack(f"<{self.form}", self.data)
        return value  # type: ignore[no-any-return]


def entry(
    form: str,
    value: int | float | bool | str,
    access: str = "ro",
    *,
    lowest: float = -math.inf,
    highest: float = math.inf,
) -> Entry:
    """Return a value of a type."""
    data = str(value).encode("latin-1") if not form else struct.pack(f"<{form}", value)
    return Entry(form=form, data=data, access=access, lowest=lowest, highest=highest)


class Dictionary(dict[tuple[int, int], Entry]):
    """Values by index and subindex."""

    def refusal(self, index: int, subindex: int, written: bytes | None) -> int | None:
        """Return the abort code for a read, or for the write of these bytes; None where it is done."""
        found = self.get((index, subindex))
        if found is None:
            return NO_SUBINDEX if any(known == index for known, _ in self) else NO_OBJECT
        if written is None:
            return WRITE_ONLY if found.access == "wo" else None
        if found.access == "ro":
            return READ_ONLY
        if not found.form:
            return TOO_LONG if len(written) > 32 else None
        if len(written) != len(found.data):
            return TOO_LONG if len(written) > len(found.data) else TOO_SHORT
        (value,) = struct.unpack(f"<{found.form}", written)
        return TOO_LOW if value < found.lowest else TOO_HIGH if value > found.highest else None


def common(name: str, device_type: int, identity: tuple[int, int, int, int], outputs: int, inputs: int) -> Dictionary:
    """Return the objects that every slave has: its name and identity, and the bytes that its process data are mapped from."""
    found = {
        (0x1000, 0): entry("I", device_type),
        (0x1008, 0): entry("", name),
        (0x1018, 0): entry("B", 4),
        **{(0x1018, sub): entry("I", value) for sub, value in enumerate(identity, start=1)},
        (0x1C00, 0): entry("B", 4),
        **{(0x1C00, sub): entry("B", sub) for sub in (1, 2, 3, 4)},
    }
    for assigned, mapping, first, size in ((0x1C12, 0x1600, 0x7000, outputs), (0x1C13, 0x1A00, 0x6000, inputs)):
        found |= {(assigned, 0): entry("B", 1), (assigned, 1): entry("H", mapping), (mapping, 0): entry("B", size)}
        found |= {(mapping, sub): entry("I", first << 16 | sub << 8 | 8) for sub in range(1, size + 1)}
    return Dictionary(found)
