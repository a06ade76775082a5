"""Journal entries and points of a PROFINET IO device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

from ..journal import JournalEntry

__all__ = ["ProfinetEntry", "as_profinet", "carried_out", "describe", "points", "title"]

_SERVICES = {
    "identify": "DCP Identify",
    "get": "DCP Get",
    "set": "DCP Set",
    "signal": "DCP Signal",
    "connect": "Connect",
    "read": "Read",
    "write": "Write",
    "control": "Control",
    "release": "Release",
    "outputs": "cyclic outputs",
    "inputs": "cyclic inputs",
    "other": "request",
}


class ProfinetEntry(JournalEntry, total=False):
    """An entry of the kind ``request``, ``cycle``, ``inputs``, ``response`` or ``message``; members that the frame does not have are absent.

    A ``cycle`` is a frame with the outputs that the device has already: a controller repeats them all the time. ``inputs`` are the device's own
    frames.

    Members:
        service: ``identify``, ``get``, ``set``, ``signal``, ``connect``, ``read``, ``write``, ``control``, ``release``, ``outputs``,
            ``inputs`` or ``other``.
        mac: hardware address of the station, in messages of DCP.
        options: options with suboptions of these, such as ``2.2``.
        name, ip: that are looked for, set, or told.
        cyclic: a Connect is for cyclic data; without, for records alone.
        sequence: number of a call.
        repeated: the request repeats the number of the call before: it was not executed again.
        slot, subslot, index: of a record.
        data: its content as hexadecimal digits.
        subslots: ``slot.subslot`` to data, of a cyclic frame, where their provider vouches for them.
        status: key of a refusal in ``codes.toml``; absent in other answers.
    """

    service: str
    mac: str
    options: list[str]
    name: str
    ip: str
    cyclic: bool
    sequence: int
    repeated: bool
    slot: int
    subslot: int
    index: int
    data: str
    subslots: dict[str, str]
    status: str


def as_profinet(entry: JournalEntry) -> ProfinetEntry:
    """Return an entry of a PROFINET journal with its own type."""
    return cast(ProfinetEntry, entry)


def title(entry: JournalEntry) -> str:
    """Return the title of an entry: its kind and, where it has one, what is asked for."""
    service = _SERVICES.get(as_profinet(entry).get("service", ""))
    return entry["kind"] if service is None else f"{entry['kind']}: {service}"


def describe(entry: JournalEntry) -> str:
    """Describe an entry in a few words."""
    if entry["kind"] not in ("request", "cycle"):
        return entry["kind"]
    request = as_profinet(entry)
    said = [_SERVICES[request["service"]]]
    if "slot" in request:
        said.append(f"{request['slot']}/{request['subslot']}/{request['index']:X}")
    said += [f"{place}={data}" for place, data in request.get("subslots", {}).items()]
    said += [request[name] for name in ("name", "ip", "data") if request.get(name)]
    if request.get("cyclic"):
        said.append("with cyclic data")
    return " ".join(said) + (" again" if request.get("repeated") else "")


def carried_out(request: JournalEntry, answer: JournalEntry | None) -> bool | None:
    """Tell whether the device did what a request asked for: cyclic outputs have no answer, others say what was refused."""
    if as_profinet(request).get("service") == "outputs":
        return True
    return None if answer is None else "status" not in as_profinet(answer)


def points(slot: int, which: str, content: bytes, offset: int = 0) -> Mapping[str, object]:
    """Return the points of an image that hold these bytes, one after the other, in subslot 1.

    Args:
        which: ``input``, ``output`` or ``record.INDEX``.
        offset: number of the first byte.
    """
    return {f"{slot}.1.{which}.{offset + index}": value for index, value in enumerate(content)}
