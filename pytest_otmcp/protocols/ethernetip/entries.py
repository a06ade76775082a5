"""Journal entries and points of a Logix controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NotRequired, TypedDict, cast

from ..journal import Entries, Image, JournalEntry

__all__ = [
    "SYMBOL",
    "TYPES",
    "EthernetIpEntry",
    "Item",
    "as_ethernetip",
    "carried_out",
    "changes",
    "describe",
    "tag_of",
    "title",
    "writes_in",
]

TYPES = {
    "BOOL": 0xC1,
    "SINT": 0xC2,
    "INT": 0xC3,
    "DINT": 0xC4,
    "LINT": 0xC5,
    "USINT": 0xC6,
    "UINT": 0xC7,
    "UDINT": 0xC8,
    "ULINT": 0xC9,
    "REAL": 0xCA,
    "LREAL": 0xCB,
}
"""Names of elementary types to their codes (volume 1, appendix C)."""
SYMBOL = 0x6B

_SERVICES = {
    "list_identity": "list identity",
    "read": "read tag",
    "write": "write tag",
    "modify": "read-modify-write tag",
    "tag_list": "list tags",
    "template": "read template",
    "identity": "read identity",
    "clock": "read clock",
    "set_clock": "set clock",
    "multiple": "multiple services",
}

# Members that are keywords of Python need this form.
_Place = TypedDict("_Place", {"class": NotRequired[int]})


class Item(_Place):
    """A service of a request, or the result of one.

    Members:
        asks: what is asked for, in the words of ``service``.
        code: of the service.
        tag: name of the tag, as the path has it.
        program: name before an instance.
        class, instance, attribute: of the path.
        steps: names and indexes behind an instance.
        type: code of the type that is written; ``handle`` of a structure.
        count: number of elements.
        offset: of a part of them, in bytes.
        data: bytes that are written, or that an answer has behind its status, in hexadecimal digits.
        excess: number of bytes behind those that were announced.
        or_mask, and_mask: of a read-modify-write, in hexadecimal digits.
        status: general status of a result; ``extended`` is the first word of its extended status.
    """

    asks: NotRequired[str]
    code: NotRequired[int]
    tag: NotRequired[str]
    program: NotRequired[str]
    instance: NotRequired[int]
    attribute: NotRequired[int]
    steps: NotRequired[list[str | int]]
    type: NotRequired[int]
    handle: NotRequired[int]
    count: NotRequired[int]
    offset: NotRequired[int]
    data: NotRequired[str]
    excess: NotRequired[int]
    or_mask: NotRequired[str]
    and_mask: NotRequired[str]
    status: NotRequired[int]
    extended: NotRequired[int]


class EthernetIpEntry(JournalEntry, total=False):
    """An entry of the kind ``request`` or ``response``, ``forward_open`` or ``forward_close``; members that a message does not have are absent.

    Members:
        service: what is asked for: ``read``, ``write``, ``modify``, ``multiple``, ``tag_list``, ``template``, ``identity``,
            ``list_identity``, ``clock``, ``set_clock``, ``other``.
        items: the services that a request consists of, or their results.
        sequence, connection_id: of a message on a CIP connection.
        route: of an Unconnected Send, in hexadecimal digits.
        status, extended: of the whole answer.
        encapsulation: status of the encapsulation header, where it is not 0.
        frame: the whole frame in hexadecimal digits.
    """

    service: str
    items: list[Item]
    sequence: int
    connection_id: int
    route: str
    status: int
    extended: int | None
    encapsulation: int
    frame: str


def as_ethernetip(entry: JournalEntry) -> EthernetIpEntry:
    """Return an entry of a Logix controller's journal with its own type."""
    return cast(EthernetIpEntry, entry)


def tag_of(item: Item, image: Image) -> str | None:
    """Return the name of the tag that a service is for, as the controller has it; None where it is for none.

    A client may name a tag by its symbol's instance, which the controller's image tells, and in whichever case.
    """
    name = item.get("tag")
    if item.get("class") == SYMBOL:
        name = image["symbols"].get(str(item.get("instance")))
        for step in item.get("steps", ()) if name else ():
            name = f"{name}[{step}]" if isinstance(step, int) else f"{name}.{step}"
    if name is None:
        return None
    return next((point for point in image["points"] if point.lower() == name.lower()), name)


def title(entry: JournalEntry) -> str:
    """Return the title of an entry: its kind and, where it has one, what is asked for."""
    service = _SERVICES.get(as_ethernetip(entry).get("service", ""))
    return entry["kind"] if service is None else f"{entry['kind']}: {service}"


def describe(entry: JournalEntry) -> str:
    """Describe an entry in a few words."""
    message = as_ethernetip(entry)
    if entry["kind"] != "request":
        return entry["kind"]
    return ", ".join(map(_described, message.get("items", []))) or message.get("service", "request")


def _described(item: Item) -> str:
    text = _SERVICES.get(item.get("asks", ""), f"service {item.get('code', 0):02X}")
    if "tag" in item:
        text += f" {item['tag']}"
    elif "class" in item and item.get("asks") in ("read", "write", "modify", "other"):
        text += f" class {item['class']:02X} instance {item.get('instance')}"
    if "data" in item:
        text += f" type {item.get('type', 0):02X} x{item.get('count')}={item['data']}"
    if "or_mask" in item:
        text += f" or {item['or_mask']} and {item['and_mask']}"
    return text


def carried_out(request: JournalEntry, answer: JournalEntry | None) -> bool | None:
    """Tell whether the controller did at least a part of what a request asked for."""
    if answer is None:
        return None
    told = as_ethernetip(answer)
    return not told.get("encapsulation") and any(item.get("status") == 0 for item in told.get("items", []))


def changes(entries: Entries) -> Sequence[JournalEntry]:
    """Return the requests that may change the plant, each once: on a CIP connection a request with the sequence count of the one before is
    the same request (volume 1, 3-4.4.2)."""
    found: list[JournalEntry] = []
    last: dict[tuple[int, int], Mapping[str, object]] = {}
    for entry in entries:
        message = as_ethernetip(entry)
        if entry["kind"] == "request" and "sequence" in message:
            place = entry["connection"], message["connection_id"]
            said = {"sequence": message["sequence"], "items": message["items"]}
            if last.get(place) == said:
                continue
            last[place] = said
        if entry["state_changing"]:
            found.append(entry)
    return found


def writes_in(entry: JournalEntry) -> int:
    """Return how many services of a request write."""
    return sum(item["asks"] in ("write", "modify") for item in as_ethernetip(entry).get("items", ()))
