"""Journal entries and points of a PROFIBUS segment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

from ..journal import JournalEntry

__all__ = ["ProfibusEntry", "as_profibus", "carried_out", "describe", "points", "title"]

_SERVICES = {
    "fdl_status": "FDL status",
    "data_exchange": "Data_Exchange",
    "set_slave_add": "Set_Slave_Add",
    "rd_inp": "RD_Inp",
    "rd_outp": "RD_Outp",
    "global_control": "Global_Control",
    "get_cfg": "Get_Cfg",
    "slave_diag": "Slave_Diag",
    "set_prm": "Set_Prm",
    "chk_cfg": "Chk_Cfg",
    "other": "request",
}
_REFUSALS = frozenset({1, 2, 3, 9})


class ProfibusEntry(JournalEntry, total=False):
    """An entry of the kind ``request``, ``cycle`` or ``response``; members that the telegram does not have are absent.

    A ``cycle`` is a Data_Exchange with the outputs that the slave has already: a master repeats them all the time, so that only
    those are in the journal whose answer is another one than before.

    Members:
        service: ``fdl_status``, ``data_exchange``, ``set_slave_add``, ``rd_inp``, ``rd_outp``, ``global_control``, ``get_cfg``,
            ``slave_diag``, ``set_prm``, ``chk_cfg`` or ``other``.
        station, master: addresses of the slave and of the master.
        function: of the frame control byte of a request.
        status: that of an answer; None for the short acknowledgement.
        count: the frame count bit, where it is valid.
        repeated: the request repeats the frame count bit: it was not executed again.
        dsap, ssap: service access points; None for the default one.
        ident: ident number of a Set_Prm, as hexadecimal digits.
        data: data as hexadecimal digits.
        telegram: the telegram as hexadecimal digits.
    """

    service: str
    station: int
    master: int
    function: int
    status: int | None
    count: bool
    repeated: bool
    dsap: int | None
    ssap: int | None
    ident: str
    data: str
    telegram: str


def as_profibus(entry: JournalEntry) -> ProfibusEntry:
    """Return an entry of a PROFIBUS journal with its own type."""
    return cast(ProfibusEntry, entry)


def title(entry: JournalEntry) -> str:
    """Return the title of an entry: its kind and, where it has one, what is asked for."""
    service = _SERVICES.get(as_profibus(entry).get("service", ""))
    return entry["kind"] if service is None else f"{entry['kind']}: {service}"


def describe(entry: JournalEntry) -> str:
    """Describe an entry in a few words."""
    if entry["kind"] not in ("request", "cycle"):
        return entry["kind"]
    request = as_profibus(entry)
    data = f" {request['data']}" if request.get("data") else ""
    again = " again" if request.get("repeated") else ""
    return f"{_SERVICES[request['service']]} to {request['station']}{data}{again}"


def carried_out(request: JournalEntry, answer: JournalEntry | None) -> bool | None:
    """Tell whether a slave did what a request asked for: it did not where it answered that it has no such service."""
    if as_profibus(request).get("service") == "global_control":
        return True
    if answer is None:
        return None
    return as_profibus(answer).get("status") not in _REFUSALS


def points(station: int, which: str, content: bytes, offset: int = 0) -> Mapping[str, object]:
    """Return the points of an image that hold these bytes, one after the other.

    Args:
        which: ``input`` or ``output``.
        offset: number of the first byte.
    """
    return {f"{station}.{which}.{offset + index}": value for index, value in enumerate(content)}
