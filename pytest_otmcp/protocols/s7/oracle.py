"""Oracles on the journal and the image of an S7 controller."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from ...core.finding import Finding
from ..journal import Entries, Image, JournalEntry
from ..oracle import Witness, requests
from .entries import BIT, DB, FLAGS, Item, as_s7, describe, points

__all__ = [
    "WITNESS",
    "changes_of_restless_bits",
    "content",
    "exactly_one_bit_write",
    "exactly_one_write",
    "held",
    "holds",
    "no_state_changing_request",
    "nothing_changed_by",
    "one_control",
    "only_changed",
    "reached",
    "read_from_device",
    "refused_with",
    "some_exchange",
]

WITNESS = Witness(noun="the controller", describe=describe)
_WIDTHS = {2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 4, 8: 4}
"""Transport size of an address, other than BIT, to bytes of one element."""

some_exchange = WITNESS.answered
no_state_changing_request = WITNESS.nothing_changed
nothing_changed_by = WITNESS.nothing_changed_by
only_changed = WITNESS.only_changed
holds = WITNESS.holds


def content(form: str, *values: float) -> bytes:
    """Return values as they lie in a data block.

    Args:
        form: characters of :mod:`struct`: ``h`` INT, ``i`` DINT, ``f`` REAL.
    """
    return struct.pack(f">{form}", *values)


def read_from_device(entries: Entries, *, db: int, start: int, size: int) -> list[Finding]:
    """Expect that the controller answered reads that cover these bytes, by whatever requests."""
    return WITNESS.was_asked(
        entries, f"DB{db} from {start}, {size} byte(s)", lambda asked: _covered(asked, db, start, size)
    )


def reached(entries: Entries, *, db: int, start: int, size: int) -> bool:
    """Tell whether reads that cover these bytes reached the controller."""
    return _covered(requests(entries), db, start, size)


def _covered(asked: Sequence[JournalEntry], db: int, start: int, size: int) -> bool:
    found: set[int] = set()
    for request in asked:
        if as_s7(request).get("service") == "read":
            for item in as_s7(request).get("items", []):
                if (item.get("area"), item.get("db")) == (DB, db):
                    found.update(_range(item))
    return found.issuperset(range(start, start + size))


def _range(item: Item) -> range:
    first = item.get("byte", 0)
    return range(first, first + _WIDTHS.get(item.get("transport", 0), 1) * item.get("count", 0))


def exactly_one_write(entries: Entries, *, db: int, start: int, written: bytes) -> list[Finding]:
    """Expect that exactly one request that may change the controller reached it: this write, as one variable."""

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        items = as_s7(entry).get("items", [])
        if as_s7(entry).get("service") != "write" or len(items) != 1:
            return "WR-001", f"it saw {describe(entry)}"
        (item,) = items
        at = (item.get("area"), item.get("db"), item.get("byte"), item.get("bit"))
        if item.get("data") != written.hex():
            swapped = at[1:3] == (db, start) and item.get("data") == written[::-1].hex()
            return "ENC-001" if swapped else "WR-001", f"it saw {describe(entry)}"
        return None if at == (DB, db, start, 0) else ("ADR-001", f"it saw {describe(entry)}")

    return WITNESS.exactly_one_write(entries, f"write of {written.hex()} to DB{db} from {start}", problem)


def exactly_one_bit_write(entries: Entries, *, byte: int, bit: int, value: bool) -> list[Finding]:
    """Expect that exactly one request that may change the controller reached it: this bit of the flags, as a bit."""
    found = WITNESS.exactly_one_write(entries, f"write of {value} to the bit M{byte}.{bit}", lambda entry: None)
    if found:
        return found
    (write,) = (entry for entry in entries if entry["state_changing"])
    items = as_s7(write).get("items", [])
    wanted = {"area": FLAGS, "byte": byte, "bit": bit, "transport": BIT, "data": f"{value:02x}"}
    if len(items) == 1 and wanted.items() <= items[0].items():
        return []
    whole = len(items) == 1 and items[0].get("area") == FLAGS and items[0].get("transport") != BIT
    return [
        Finding(
            code="not_one_bit" if whole and byte in _range(items[0]) else "not_written_once",
            message=f"the controller should have seen one write of {value} to the bit M{byte}.{bit}, it saw {describe(write)}",
            requirement="WR-011" if whole and byte in _range(items[0]) else "WR-001",
            evidence=WITNESS.seen(entries),
        )
    ]


def one_control(entries: Entries, service: str) -> list[Finding]:
    """Expect that exactly one request that may change the controller reached it: to ``stop`` it, or to ``control`` it."""

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        return None if as_s7(entry).get("service") == service else ("WR-001", f"it saw {describe(entry)}")

    return WITNESS.exactly_one_write(entries, f"request '{service}'", problem)


def refused_with(entries: Entries, code: int) -> list[Finding]:
    """Expect that the controller answered with this return code, or this error."""
    sent: list[int | None] = []
    for entry in entries:
        if entry["kind"] == "response":
            sent += [as_s7(entry).get("error"), *(item.get("code") for item in as_s7(entry).get("items", []))]
    if code in sent:
        return []
    shown = [f"{found:02X}" for found in sent if found is not None]
    return WITNESS.no_refusal(entries, f"{code:02X}", shown, requirement="ERR-002")


def held(image: Image, area: str, byte: int, size: int) -> bytes:
    """Return the bytes that the controller holds."""
    found = image["points"]
    return bytes(found[name] for name in points(area, byte, bytes(size)))


def changes_of_restless_bits(image: Image) -> int:
    """Return how often the bits that turn by themselves have turned."""
    return sum(bits["changes"] for bits in image["restless"])
