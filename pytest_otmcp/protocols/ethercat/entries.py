"""Journal entries and points of an EtherCAT segment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import cast

from ..journal import JournalEntry

__all__ = ["EthercatEntry", "as_ethercat", "carried_out", "describe", "facts", "points", "title"]

_SERVICES = {
    "scan": "scan",
    "al_status": "AL status",
    "state": "AL control",
    "sdo_upload": "SDO upload",
    "sdo_download": "SDO download",
    "inputs": "inputs",
    "process_data": "process data",
    "other": "request",
}


class EthercatEntry(JournalEntry, total=False):
    """An entry of the kind ``request``, ``cycle`` or ``response``; members that the datagram does not have are absent.

    A ``cycle`` is a frame with process data that changes no outputs: a master sends a hundred of those a second, so that only those are in
    the journal whose answer is another one than before, and the first after each reading of the journal.

    Members:
        service: ``scan``, ``al_status``, ``state``, ``sdo_upload``, ``sdo_download``, ``inputs``, ``process_data`` or ``other``.
        command: of the datagram.
        slave: position of the slave, as the mock says it.
        station: address that the master has given it.
        state: that is asked for.
        index, subindex: of an object.
        data: value of an object, or process data, as hexadecimal digits.
        outputs: that the slave gets, as hexadecimal digits.
        abort: abort code of an answer; None where it has none.
        counter: working counter of an answer.
    """

    service: str
    command: int
    slave: int
    station: int
    state: str
    index: int
    subindex: int
    data: str
    outputs: str
    abort: int | None
    counter: int


def as_ethercat(entry: JournalEntry) -> EthercatEntry:
    """Return an entry of an EtherCAT journal with its own type."""
    return cast(EthercatEntry, entry)


def title(entry: JournalEntry) -> str:
    """Return the title of an entry: its kind and, where it has one, what is asked for."""
    service = _SERVICES.get(as_ethercat(entry).get("service", ""))
    return entry["kind"] if service is None else f"{entry['kind']}: {service}"


def describe(entry: JournalEntry) -> str:
    """Describe an entry in a few words."""
    if entry["kind"] not in ("request", "cycle"):
        return entry["kind"]
    asked = as_ethercat(entry)
    words = [_SERVICES.get(asked["service"], "request")]
    if "slave" in asked:
        words.append(f"of slave {asked['slave']}")
    if "index" in asked:
        words.append(f"{asked['index']:04X}:{asked['subindex']}")
    if "state" in asked:
        words.append(asked["state"])
    if asked["service"] == "sdo_download" or "outputs" in asked:
        words.append(asked.get("outputs", asked["data"]))
    return " ".join(words)


def carried_out(request: JournalEntry, answer: JournalEntry | None) -> bool | None:
    """Tell whether a slave did what a request asked for: it did not where it aborted the transfer."""
    if answer is None:
        return None
    return as_ethercat(answer).get("abort") is None


def points(slave: int, which: str, content: bytes, offset: int = 0) -> Mapping[str, object]:
    """Return the points of an image that hold these bytes, one after the other.

    Args:
        which: ``input`` or ``output``.
        offset: number of the first byte.
    """
    return {f"{slave}.{which}.{offset + index}": value for index, value in enumerate(content)}


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a message gives ``meta.trace`` to say: ``slave``, ``index``, ``subindex`` and ``abort_code``."""
    told = as_ethercat(entry)
    if entry["kind"] == "response":
        abort = told.get("abort")
        return {} if abort is None else {"abort_code": [f"{abort:08X}", abort]}
    if entry["kind"] not in ("request", "cycle"):
        return {}
    found: dict[str, Sequence[object]] = {}
    for name in ("slave", "index", "subindex"):
        if name in told:
            found[name] = [told[name]]
    return found
