"""Fragments: application header, function, objects, and what journal entries say of them (IEEE 1815, clause 4.2).

Requests are described as far as their bytes go, also those that an outstation refuses.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ..framing import MalformedError
from .objects import Header, IllegalObject, UnknownObject, headers

__all__ = [
    "BROADCASTS",
    "COLD_RESTART",
    "CONFIRM",
    "DELAY_MEASURE",
    "DIRECT_OPERATE",
    "DIRECT_OPERATE_NR",
    "DISABLE_UNSOLICITED",
    "ENABLE_UNSOLICITED",
    "OPERATE",
    "READ",
    "RECORD_CURRENT_TIME",
    "RESPONSE",
    "SELECT",
    "UNSOLICITED_RESPONSE",
    "WRITE",
    "Request",
    "response_fields",
]

CONFIRM, READ, WRITE, SELECT, OPERATE, DIRECT_OPERATE, DIRECT_OPERATE_NR = range(7)
COLD_RESTART, ENABLE_UNSOLICITED, DISABLE_UNSOLICITED, DELAY_MEASURE, RECORD_CURRENT_TIME = 13, 20, 21, 23, 24
RESPONSE, UNSOLICITED_RESPONSE = 129, 130
_UNCHANGING = {CONFIRM, READ, ENABLE_UNSOLICITED, DISABLE_UNSOLICITED, DELAY_MEASURE, RECORD_CURRENT_TIME}
"""Every other function may change the plant: freezing, restarts, applications, configuration, classes, files. A WRITE does, unless it is
housekeeping, see :meth:`Request.housekeeping`."""
_WITH_OBJECTS = {WRITE, SELECT, OPERATE, DIRECT_OPERATE, DIRECT_OPERATE_NR}
_FIRST_RESPONSE = 0x80
BROADCASTS = range(0xFFFD, 0x10000)
"""Link addresses that are every outstation's."""

_FIR, _FIN, _CONFIRM_ME, _UNSOLICITED = 0x80, 0x40, 0x20, 0x10
_RESTART_BIT = 7


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """A request.

    Attributes:
        unsolicited: of a confirmation: it confirms an unsolicited response.
        headers: its objects, as far as they could be read.
        problem: why they could not, or None.
        fragment: its bytes.
    """

    sequence: int
    function: int
    unsolicited: bool
    headers: Sequence[Header]
    problem: IllegalObject | None
    fragment: bytes

    @classmethod
    def parse(cls, fragment: bytes) -> Request:
        """Read a request.

        Raises:
            MalformedError: it is none, or not whole.
        """
        if len(fragment) < 2:
            raise MalformedError("application: a fragment without its header")
        control, function = fragment[:2]
        if control & (_FIR | _FIN) != _FIR | _FIN:
            raise MalformedError("application: a request that is no whole fragment")
        if function >= _FIRST_RESPONSE:
            raise MalformedError(f"application: the function {function} of an outstation")
        found: Sequence[Header] = ()
        problem: IllegalObject | None = None
        try:
            found = headers(fragment[2:], with_objects=function in _WITH_OBJECTS)
        except IllegalObject as error:
            problem = error
        return cls(
            sequence=control & 0x0F,
            function=function,
            unsolicited=bool(control & _UNSOLICITED),
            headers=found,
            problem=problem,
            fragment=fragment,
        )

    @property
    def housekeeping(self) -> bool:
        """Whether it writes what every master writes: it clears the restart bit, or sets the clock."""
        return (
            self.function == WRITE
            and bool(self.headers)
            and all(header.group == 50 or _clears_restart(header) for header in self.headers)
        )

    @property
    def state_changing(self) -> bool:
        """Whether it may change the plant, also where it is refused."""
        return self.function not in _UNCHANGING and not self.housekeeping

    def described(self) -> dict[str, Any]:
        """Return the members that a journal entry has of it."""
        found: dict[str, Any] = {"function": self.function, "sequence": self.sequence}
        if self.function == CONFIRM:
            return {**found, "unsolicited": self.unsolicited}
        found["objects"] = [header.described() for header in self.headers]
        return found | ({"problem": str(self.problem)} if self.problem is not None else {})

    def concerns(self, group: int | None, index: int | None) -> bool:
        """Tell whether it names objects of a group, and a point; None stands for any."""
        if group is None and index is None:
            return True
        return any(group in (None, header.group) and _names(header, index) for header in self.headers)

    @property
    def unknown(self) -> bool:
        """Whether it names an object that cannot even be read."""
        return isinstance(self.problem, UnknownObject)


def response_fields(fragment: bytes) -> dict[str, Any]:
    """Return what a response says; of objects that cannot be read nothing.

    Raises:
        MalformedError: it is none, or not whole.
    """
    if len(fragment) < 4:
        raise MalformedError("application: a fragment without its header")
    control, function = fragment[:2]
    if control & (_FIR | _FIN) != _FIR | _FIN:
        raise MalformedError("application: a response that is no whole fragment")
    if function not in (RESPONSE, UNSOLICITED_RESPONSE):
        raise MalformedError(f"application: the function {function} of a master")
    fields = {"function": function, "sequence": control & 0x0F}
    fields |= {"iin": int.from_bytes(fragment[2:4], "little"), "confirm": bool(control & _CONFIRM_ME)}
    with contextlib.suppress(IllegalObject):
        return {**fields, "objects": [header.described() for header in headers(fragment[4:], with_objects=True)]}
    return {**fields, "objects": []}


def _clears_restart(header: Header) -> bool:
    return (header.group, header.variation) == (80, 1) and [*header.points] == [{"index": _RESTART_BIT, "value": False}]


def _names(header: Header, index: int | None) -> bool:
    if index is None:
        return True
    if header.start is not None and header.stop is not None:
        return header.start <= index <= header.stop
    return any(point.get("index") == index for point in header.points)
