"""Journal entries and points of a DNP3 outstation. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

from ..journal import Entries, JournalEntry

__all__ = [
    "DIRECT_OPERATE",
    "GROUPS",
    "OPERATE",
    "SELECT",
    "Dnp3Entry",
    "as_dnp3",
    "carried_out",
    "changes",
    "commands",
    "describe",
    "objects",
    "title",
]

READ, WRITE, SELECT, OPERATE, DIRECT_OPERATE, DIRECT_OPERATE_NR = range(1, 7)
GROUPS = {
    "binary_input": 1,
    "binary_output": 10,
    "counter": 20,
    "analog_input": 30,
    "analog_output": 40,
    "octet_string": 110,
}
"""Types of points to the groups of their static objects."""

_ERRORS = 0x3F00
"""Internal indications by which an outstation refuses: the second octet."""
_OUTSTATION = 10

_FUNCTIONS = {
    0: "confirm",
    1: "read",
    2: "write",
    3: "select",
    4: "operate",
    5: "direct operate",
    6: "direct operate without response",
    7: "freeze",
    8: "freeze without response",
    9: "freeze and clear",
    10: "freeze and clear without response",
    11: "freeze at time",
    12: "freeze at time without response",
    13: "cold restart",
    14: "warm restart",
    15: "initialize data",
    16: "initialize application",
    17: "start application",
    18: "stop application",
    19: "save configuration",
    20: "enable unsolicited",
    21: "disable unsolicited",
    22: "assign class",
    23: "delay measurement",
    24: "record current time",
    25: "open file",
    26: "close file",
    27: "delete file",
    28: "get file information",
    29: "authenticate file",
    30: "abort file",
    31: "activate configuration",
}
_LINK_FUNCTIONS = {0: "reset", 2: "test", 9: "status"}
_CODES = {1: "pulse on", 2: "pulse off", 3: "latch on", 4: "latch off", 0x41: "close", 0x81: "trip"}


class Dnp3Entry(JournalEntry, total=False):
    """An entry of a DNP3 outstation; members that the message does not have are absent.

    Members:
        function: function code.
        sequence: application sequence number.
        source, destination: link addresses of a request.
        objects: object headers: ``group``, ``variation``, ``qualifier``; ``start`` and ``stop`` of a range, ``count``; ``points``, each with
            its ``index`` and what the object says: ``value``, ``flags``, ``time_ms``, ``octets``, or ``code``, ``count``, ``on_ms``,
            ``off_ms`` and ``status`` of a command.
        problem: why the objects of a request cannot be read.
        iin: internal indications of a response, the first octet in the lower byte.
        confirm: the response has to be confirmed.
        unsolicited: of a confirmation: it confirms an unsolicited response.
        link_function: function of a frame of the link layer alone.
        apdu: the application fragment in hexadecimal digits.
    """

    function: int
    sequence: int
    source: int
    destination: int
    objects: list[dict[str, Any]]
    problem: str
    iin: int
    confirm: bool
    unsolicited: bool
    link_function: int
    apdu: str


def as_dnp3(entry: JournalEntry) -> Dnp3Entry:
    """Return an entry of a DNP3 outstation's journal with its own type."""
    return cast(Dnp3Entry, entry)


def objects(entry: JournalEntry) -> Sequence[Mapping[str, Any]]:
    """Return the object headers of an entry."""
    return as_dnp3(entry).get("objects", [])


def commands(entry: JournalEntry) -> list[Mapping[str, Any]]:
    """Return the commands of an entry, control relay output blocks and analog outputs, each with its ``group``."""
    return [
        {"group": header["group"], "variation": header["variation"], **point}
        for header in objects(entry)
        if header["group"] in (12, 41)
        for point in header.get("points", [])
    ]


def title(entry: JournalEntry) -> str:
    """Return the title of an entry: its kind and its function."""
    message = as_dnp3(entry)
    if "link_function" in message:
        return f"{entry['kind']}: link {_LINK_FUNCTIONS.get(message['link_function'], message['link_function'])}"
    name = _FUNCTIONS.get(message.get("function", -1))
    return entry["kind"] if name is None or entry["kind"] != "request" else f"{entry['kind']}: {name}"


def describe(entry: JournalEntry) -> str:
    """Describe an entry in a few words."""
    message = as_dnp3(entry)
    if entry["kind"] == "link_request":
        return f"link {_LINK_FUNCTIONS.get(message['link_function'], message['link_function'])}"
    if entry["kind"] != "request":
        return entry["kind"]
    text = _FUNCTIONS.get(message["function"], f"function {message['function']}")
    to = "" if message.get("destination") == _OUTSTATION else f" to outstation {message.get('destination')}"
    return " ".join([text, *map(_header, objects(entry))]) + to


def _header(header: Mapping[str, Any]) -> str:
    text = f"g{header['group']}v{header['variation']}"
    if "start" in header:
        text += f" {header['start']}-{header['stop']}"
    for point in header.get("points", []):
        said = _CODES.get(point["code"], f"code {point['code']:02X}") if "code" in point else point.get("value")
        text += f" {point.get('index', '')}" + (f"={said}" if said is not None else "")
    return text


def carried_out(request: JournalEntry, answer: JournalEntry | None) -> bool | None:
    """Tell whether the outstation did at least a part of what a request asked for. A selection does nothing by itself."""
    message = as_dnp3(request)
    if message.get("function") == SELECT:
        return False
    if message.get("function") == DIRECT_OPERATE_NR:
        return True
    if answer is None:
        return None
    told = [point["status"] for point in commands(answer)]
    return not as_dnp3(answer).get("iin", 0) & _ERRORS and (not told or 0 in told)


def changes(entries: Entries) -> list[JournalEntry]:
    """Return the requests that may change the plant, each once.

    A master that misses a response sends the request again, byte by byte and next on its connection: that is the same request (clause
    4.2.2.4). A SELECT and the OPERATE with the same objects that follows it are one change; a SELECT that nothing follows is one, too.
    """
    found: list[JournalEntry] = []
    last: dict[int, str | None] = {}
    for entry in entries:
        if not entry["request"]:
            continue
        apdu = as_dnp3(entry).get("apdu")
        repeated = apdu is not None and last.get(entry["connection"]) == apdu
        last[entry["connection"]] = apdu
        if entry["state_changing"] and not repeated:
            found.append(entry)
    return [entry for place, entry in enumerate(found) if not _is_followed(entry, found[place + 1 :])]


def _is_followed(entry: JournalEntry, later: Sequence[JournalEntry]) -> bool:
    """Tell whether an entry is a SELECT after which the same objects are selected or operated on the same connection."""
    message = as_dnp3(entry)
    return message.get("function") == SELECT and any(
        one["connection"] == entry["connection"]
        and as_dnp3(one).get("function") in (SELECT, OPERATE)
        and as_dnp3(one).get("apdu", "")[4:] == message.get("apdu", "")[4:]
        for one in later
    )
