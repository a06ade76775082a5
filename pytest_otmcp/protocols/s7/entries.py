"""Journal entries and points of an S7 controller."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NotRequired, TypedDict, cast

from ..journal import JournalEntry

__all__ = ["BIT", "DB", "FLAGS", "Item", "S7Entry", "as_s7", "carried_out", "describe", "points", "title"]

INPUTS, OUTPUTS, FLAGS, DB = 0x81, 0x82, 0x83, 0x84
BIT = 1
"""Transport size of an address."""
_AREAS = {INPUTS: "I", OUTPUTS: "Q", FLAGS: "M"}
_SUCCESS = 0xFF

_SERVICES = {
    "setup": "agree on a PDU",
    "read": "read variables",
    "write": "write variables",
    "control": "control the CPU",
    "stop": "stop the CPU",
    "szl": "read system status list",
    "clock": "read clock",
    "set_clock": "set clock",
}


class Item(TypedDict):
    """A variable of a request, or the result for one.

    Members:
        area: 81 inputs, 82 outputs, 83 flags, 84 data block, hexadecimal.
        db: number of the data block; 0 for other areas.
        byte, bit: of the address.
        transport: transport size of the address: 1 BIT, 2 BYTE, 4 WORD, 5 INT, 8 REAL, …
        count: number of elements.
        data: bytes that are written or were read, in hexadecimal digits.
        code: return code of a result.
    """

    area: NotRequired[int]
    db: NotRequired[int]
    byte: NotRequired[int]
    bit: NotRequired[int]
    transport: NotRequired[int]
    count: NotRequired[int]
    data: NotRequired[str]
    code: NotRequired[int]


class S7Entry(JournalEntry, total=False):
    """An entry of the kind ``request`` or ``response``, ``setup`` or ``setup_response``; members that the PDU does not have are
    absent.

    Members:
        service: what is asked for: ``setup``, ``read``, ``write``, ``control``, ``stop``, ``szl``, ``clock``, ``set_clock``, ``other``.
        reference: PDU reference.
        function: of a job.
        group, subfunction: of user data.
        items: variables of a read or write, or their results.
        szl_id, szl_index: of a system status list.
        error: class and code of an answer's error, or None.
        code: return code of an answer to user data.
        pdu: the PDU in hexadecimal digits.
    """

    service: str
    reference: int
    function: int
    group: int
    subfunction: int
    items: list[Item]
    szl_id: int
    szl_index: int
    error: int | None
    code: int | None
    pdu: str


def as_s7(entry: JournalEntry) -> S7Entry:
    """Return an entry of an S7 controller's journal with its own type."""
    return cast(S7Entry, entry)


def title(entry: JournalEntry) -> str:
    """Return the title of an entry: its kind and, where it has one, what is asked for."""
    service = _SERVICES.get(as_s7(entry).get("service", ""))
    return entry["kind"] if service is None else f"{entry['kind']}: {service}"


def describe(entry: JournalEntry) -> str:
    """Describe an entry in a few words."""
    if entry["kind"] != "request":
        return entry["kind"]
    request = as_s7(entry)
    text = _SERVICES.get(request["service"], f"function {request.get('function', 0):02X}")
    if "szl_id" in request:
        return f"{text} {request['szl_id']:04X}"
    return " ".join([text, *(_address(item) for item in request.get("items", []))])


def _address(item: Item) -> str:
    area, byte = item.get("area", 0), item.get("byte", 0)
    place = f"DB{item.get('db')}" if area == DB else _AREAS.get(area, f"area {area:02X}")
    bit = f".{item.get('bit')}" if item.get("transport") == BIT else f" x{item.get('count')}"
    data = f"={item['data']}" if "data" in item else ""
    return f"{place} {byte}{bit}{data}"


def carried_out(request: JournalEntry, answer: JournalEntry | None) -> bool | None:
    """Tell whether the controller did at least a part of what a request asked for."""
    if answer is None:
        return None
    told = as_s7(answer)
    codes = [item.get("code") for item in told.get("items", [])]
    return not told.get("error") and (not codes or _SUCCESS in codes)


def points(area: str, byte: int, content: bytes) -> Mapping[str, object]:
    """Return the points of an image that hold these bytes, one after the other.

    Args:
        area: such as ``DB10`` or ``M``.
    """
    name = f"{area}.DBB" if area.startswith("DB") else f"{area}B"
    return {f"{name}{byte + offset}": value for offset, value in enumerate(content)}
