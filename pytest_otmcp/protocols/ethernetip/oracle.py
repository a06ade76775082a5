"""Oracles on the journal and the image of a Logix controller."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Sequence

from ...core.finding import Finding
from ..journal import Entries, Image, JournalEntry
from ..oracle import Witness, requests
from .entries import TYPES, Item, as_ethernetip, changes, describe, tag_of

__all__ = [
    "WITNESS",
    "changes_asked_for",
    "changes_of_restless_bits",
    "connections_forgotten",
    "connections_left",
    "content",
    "exactly_one_bit_write",
    "exactly_one_write",
    "held",
    "holds",
    "no_state_changing_request",
    "nothing_changed_by",
    "one_clock_setting",
    "only_changed",
    "reached",
    "read_from_device",
    "refused_with",
    "some_exchange",
]

WITNESS = Witness(noun="the controller", describe=describe)
_FORMS = {
    "SINT": "b",
    "INT": "h",
    "DINT": "i",
    "LINT": "q",
    "USINT": "B",
    "UINT": "H",
    "UDINT": "I",
    "ULINT": "Q",
    "REAL": "f",
    "LREAL": "d",
}
_INDEX = re.compile(r"(?P<array>.+)\[(?P<index>[0-9]+)\]")
_STRING_HANDLE, _STRING_SIZE = 0x0FCE, 88

some_exchange = WITNESS.answered
no_state_changing_request = WITNESS.nothing_changed
nothing_changed_by = WITNESS.nothing_changed_by
only_changed = WITNESS.only_changed
holds = WITNESS.holds


def content(kind: str, *values: object) -> bytes:
    """Return values as a write has them.

    Args:
        kind: an elementary type, or ``STRING`` (a length of 4 bytes, 82 characters and 2 bytes of padding).
    """
    if kind == "BOOL":
        return bytes(0xFF if value else 0 for value in values)
    if kind == "STRING":
        texts = (str(value).encode("latin-1") for value in values)
        return b"".join((struct.pack("<i", len(text)) + text).ljust(_STRING_SIZE, b"\0") for text in texts)
    return struct.pack(f"<{len(values)}{_FORMS[kind]}", *values)


def held(image: Image, tag: str) -> object:
    """Return the value that the controller holds."""
    return image["points"][tag]


def read_from_device(entries: Entries, image: Image, tags: Iterable[str]) -> list[Finding]:
    """Expect that the controller answered reads of all these values, by whatever requests.

    Args:
        tags: names of values as the image has them.
    """
    wanted = list(tags)
    return WITNESS.was_asked(entries, ", ".join(wanted), lambda asked: _cover(asked, image, wanted))


def reached(entries: Entries, image: Image, tags: Iterable[str]) -> bool:
    """Tell whether reads of all these values reached the controller."""
    return _cover(requests(entries), image, list(tags))


def _cover(asked: Sequence[JournalEntry], image: Image, tags: Sequence[str]) -> bool:
    items = [item for entry in asked for item in as_ethernetip(entry).get("items", []) if item.get("asks") == "read"]
    return all(any(_covers(item, image, tag) for item in items) for tag in tags)


def _covers(item: Item, image: Image, tag: str) -> bool:
    read = tag_of(item, image)
    if read is None:
        return False
    if tag == read or tag.startswith(f"{read}."):
        return True
    element = _INDEX.fullmatch(tag)
    first = _INDEX.fullmatch(read)
    if element is None or element["array"] != (read if first is None else first["array"]):
        return False
    start = 0 if first is None else int(first["index"])
    return start <= int(element["index"]) < start + item.get("count", 1)


def exactly_one_write(
    entries: Entries, image: Image, tag: str, kind: str, *values: object, among: int = 1
) -> list[Finding]:
    """Expect that exactly one request that may change the controller reached it: this write.

    Args:
        tag: name of the value, or of the first of several elements, as the image has it.
        kind: type of the values: it is a part of what is asked for.
        among: so many services the request consists of.
    """
    wanted = content(kind, *values)

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        items = as_ethernetip(entry).get("items", [])
        of_it = [item for item in items if _names(item, image, tag, len(values))]
        if len(items) != among or len(of_it) > 1:
            return "WR-001", f"it saw {describe(entry)}"
        if not of_it or of_it[0].get("asks") != "write":
            return "ADR-001" if not of_it else "WR-001", f"it saw {describe(entry)}"
        (item,) = of_it
        if (item.get("handle") if kind == "STRING" else item.get("type")) != TYPES.get(kind, _STRING_HANDLE):
            return "ENC-001", f"it saw the type {item.get('type', 0):02X}"
        if item.get("count") != len(values) or not _same(kind, item.get("data", ""), wanted):
            swapped = item.get("data") == wanted[::-1].hex()
            return "ENC-001" if swapped else "WR-001", f"it saw {describe(entry)}"
        return None

    what = ", ".join(map(str, values))
    return WITNESS.exactly_one_write(changes(entries), f"write of {what} ({kind}) to {tag}", problem)


def _names(item: Item, image: Image, tag: str, count: int) -> bool:
    """Tell whether a service is for this value; the first element of an array is also meant by the array's name."""
    named = tag_of(item, image)
    return named == tag or (named is not None and tag == f"{named}[0]" and item.get("count") == count)


def _same(kind: str, data: str, wanted: bytes) -> bool:
    found = bytes.fromhex(data)
    if kind == "BOOL":
        # Whatever is not 0 stands for true.
        return [byte != 0 for byte in found] == [byte != 0 for byte in wanted]
    if kind == "STRING":
        # What is behind the text is nobody's.
        used = 4 + int.from_bytes(wanted[:4], "little")
        return found[:used] == wanted[:used]
    return found == wanted


def exactly_one_bit_write(entries: Entries, image: Image, tag: str, bit: int, value: bool) -> list[Finding]:
    """Expect that exactly one request that may change the controller reached it: this bit of this tag, by masks that spare the others."""
    found = WITNESS.exactly_one_write(changes(entries), f"write of {value} to the bit {tag}.{bit}", lambda entry: None)
    if found:
        return found
    (write,) = changes(entries)
    items = as_ethernetip(write).get("items", [])
    if len(items) == 1 and tag_of(items[0], image) == tag and _one_bit(items[0], bit, value):
        return []
    whole = len(items) == 1 and tag_of(items[0], image) == tag
    return [
        Finding(
            code="not_one_bit" if whole else "not_written_once",
            message=f"the controller should have seen one write of {value} to the bit {tag}.{bit}, it saw {describe(write)}",
            requirement="WR-011" if whole else "WR-001",
            evidence=WITNESS.seen(entries),
        )
    ]


def _one_bit(item: Item, bit: int, value: bool) -> bool:
    if item.get("asks") != "modify":
        return False
    set_bits, kept = bytes.fromhex(item["or_mask"]), bytes.fromhex(item["and_mask"])
    every = (1 << 8 * len(set_bits)) - 1
    wanted = (1 << bit, every) if value else (0, every & ~(1 << bit))
    return (int.from_bytes(set_bits, "little"), int.from_bytes(kept, "little")) == wanted


def one_clock_setting(entries: Entries) -> list[Finding]:
    """Expect that exactly one request that may change the controller reached it: to set its clock."""

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        asked = [item.get("asks") for item in as_ethernetip(entry).get("items", [])]
        return None if asked == ["set_clock"] else ("WR-001", f"it saw {describe(entry)}")

    return WITNESS.exactly_one_write(changes(entries), "setting of the clock", problem)


def refused_with(entries: Entries, status: int, extended: int | None = None) -> list[Finding]:
    """Expect that the controller answered a service with this general status, and this extended status if there is one."""
    sent = [
        (item.get("status"), item.get("extended"))
        for entry in entries
        if entry["kind"] == "response"
        for item in as_ethernetip(entry).get("items", [])
    ]
    if any(one == status and extended in (None, more) for one, more in sent):
        return []
    shown = [f"{one:02X}" + ("" if more is None else f"/{more:04X}") for one, more in sent if one is not None]
    wanted = f"{status:02X}" + ("" if extended is None else f"/{extended:04X}")
    return WITNESS.no_refusal(entries, f"the status {wanted}", shown, requirement="ERR-002")


def connections_left(image: Image, *, most: int) -> list[Finding]:
    """Expect that no more than so many CIP connections are open."""
    if image["connections"] <= most:
        return []
    message = f"the controller should have {most} open connection(s) or fewer, it has {image['connections']}"
    return [Finding(code="connections_left", message=message, requirement="RES-001")]


def connections_forgotten(image: Image, *, most: int) -> list[Finding]:
    """Expect that no more than so many CIP connections ended without a Forward Close: a controller may keep them for minutes."""
    if image["forgotten"] <= most:
        return []
    message = f"the controller should have seen a Forward Close for each connection, {image['forgotten'] - most} ended without one"
    return [Finding(code="connections_left", message=message, requirement="RES-001")]


def changes_asked_for(entries: Entries) -> bool:
    """Tell whether a request that may change the plant reached the controller."""
    return bool(changes(entries))


def changes_of_restless_bits(image: Image) -> int:
    """Return how often the bits that turn by themselves have turned."""
    return sum(bits["changes"] for bits in image["restless"])
