"""The codec of classic S7 communication.

TPKT: RFC 1006, section 6. COTP class 0: ITU-T X.224, section 13. S7 itself was never published; the layout of its header, jobs and
user data is the one that is publicly known (Wireshark's dissector). Requests are described as far as their bytes go, also those
that a controller refuses: the bytes that arrived are evidence.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from .framing import MalformedError

__all__ = [
    "ACK",
    "ACK_DATA",
    "CLOCK",
    "CONNECT_REQUEST",
    "DATA",
    "DISCONNECT_REQUEST",
    "JOB",
    "READ",
    "SETUP",
    "SET_CLOCK",
    "SUCCESS",
    "SZL",
    "USER_DATA",
    "WRITE",
    "Connect",
    "Pdu",
    "Variable",
    "answer_fields",
    "confirm",
    "data_frame",
    "refuse",
    "request_fields",
    "tpkt_length",
    "variables",
    "written_data",
]

CONNECT_REQUEST, CONNECT_CONFIRM, DISCONNECT_REQUEST, DATA = 0xE0, 0xD0, 0x80, 0xF0
JOB, ACK, ACK_DATA, USER_DATA = 1, 2, 3, 7

_VERSION = 3
_PROTOCOL = 0x32
_TPDU_SIZE, _CALLING, _CALLED = 0xC0, 0xC1, 0xC2
_LARGEST_TPDU = 0x0A
"""2 to this power, 1024 bytes: more than any PDU here, so that no PDU is cut into several TPDUs."""
_OUR_REFERENCE = 0x0001
_ADDRESS_UNKNOWN = 3


READ, WRITE, SETUP = 0x04, 0x05, 0xF0
SZL, CLOCK, SET_CLOCK = (4, 1), (7, 1), (7, 2)
"""Function group and subfunction of user data."""
STATE_CHANGING_JOBS = frozenset({WRITE, 0x1A, 0x1B, 0x1C, 0x28, 0x29})
"""Jobs that can change the controller: write, download, control (start, compress, copy to ROM), stop."""
STATE_CHANGING_USER_DATA = frozenset({SET_CLOCK})
SUCCESS = 0xFF
"""Code of a variable that was read or written."""

_SERVICES = {SETUP: "setup", READ: "read", WRITE: "write", 0x28: "control", 0x29: "stop"}
_INFORMATION = {SZL: "szl", CLOCK: "clock", SET_CLOCK: "set_clock"}
_ANY_POINTER = bytes([0x12, 0x0A, 0x10])
_LENGTH_IN_BITS = frozenset({3, 4, 5})
"""Transport sizes of data whose length is told in bits; others in bytes."""


def tpkt_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the TPKT at the beginning of the buffer.

    Raises:
        MalformedError: the version is not 3, or the length is impossible.
    """
    if buffer and buffer[0] != 3:
        raise MalformedError(f"the version of the TPKT is {buffer[0]}, it must be 3")
    if len(buffer) < 4:
        return None
    length = int.from_bytes(buffer[2:4], "big")
    if length < 7:
        raise MalformedError(f"the length of the TPKT is {length}, it must be 7 or more")
    return length


@dataclass(frozen=True, slots=True, kw_only=True)
class Connect:
    """A COTP connection request: the client's reference, and the TSAPs of both ends."""

    reference: int
    calling: bytes
    called: bytes

    @classmethod
    def parse(cls, tpdu: bytes) -> Connect:
        """Read a connection request.

        Raises:
            MalformedError: it is none, or incomplete.
        """
        if len(tpdu) < 7 or tpdu[0] != len(tpdu) - 1:
            raise MalformedError("COTP: a connection request of a wrong length")
        found: dict[int, bytes] = {}
        rest = tpdu[7:]
        while rest:
            if len(rest) < 2 or len(rest) < 2 + rest[1]:
                raise MalformedError("COTP: a parameter that is cut off")
            found[rest[0]], rest = rest[2 : 2 + rest[1]], rest[2 + rest[1] :]
        return cls(
            reference=int.from_bytes(tpdu[4:6]), calling=found.get(_CALLING, b""), called=found.get(_CALLED, b"")
        )

    @property
    def rack(self) -> int:
        """Rack that is called, by a TSAP of two bytes."""
        return self.called[1] >> 5

    @property
    def slot(self) -> int:
        """Slot that is called, by a TSAP of two bytes."""
        return self.called[1] & 0x1F


def _tpkt(tpdu: bytes) -> bytes:
    return struct.pack(">BBH", _VERSION, 0, 4 + len(tpdu)) + tpdu


def confirm(request: Connect) -> bytes:
    """Return the frame that accepts a connection."""
    parameters = bytes([_TPDU_SIZE, 1, _LARGEST_TPDU])
    for code, tsap in ((_CALLING, request.calling), (_CALLED, request.called)):
        parameters += bytes([code, len(tsap)]) + tsap
    fixed = struct.pack(">BHHB", CONNECT_CONFIRM, request.reference, _OUR_REFERENCE, 0)
    return _tpkt(bytes([len(fixed + parameters)]) + fixed + parameters)


def refuse(request: Connect) -> bytes:
    """Return the frame that refuses a connection: there is nothing at this address (X.224, 13.5.3)."""
    return _tpkt(struct.pack(">BBHHB", 6, DISCONNECT_REQUEST, request.reference, 0, _ADDRESS_UNKNOWN))


def data_frame(pdu: bytes) -> bytes:
    """Return the frame that carries a PDU."""
    return _tpkt(bytes([2, DATA, 0x80]) + pdu)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pdu:
    """An S7 PDU.

    Attributes:
        rosctr: kind: 1 job, 2 acknowledgement, 3 acknowledgement with data, 7 user data.
        reference: number that the answer repeats.
        error: class and code of an acknowledgement's error, 0 for none; other kinds have none.
    """

    rosctr: int
    reference: int
    parameters: bytes
    data: bytes = b""
    error: int = 0

    @classmethod
    def parse(cls, raw: bytes) -> Pdu:
        """Read a PDU.

        Raises:
            MalformedError: it is none, or its lengths do not fit.
        """
        if len(raw) < 10 or raw[0] != _PROTOCOL or raw[1] not in (JOB, ACK, ACK_DATA, USER_DATA):
            raise MalformedError("it is no S7 PDU")
        reference, parameters, data = struct.unpack_from(">HHH", raw, 4)
        head = 12 if raw[1] in (ACK, ACK_DATA) else 10
        if len(raw) != head + parameters + data:
            raise MalformedError("its lengths do not fit")
        return cls(
            rosctr=raw[1],
            reference=reference,
            parameters=raw[head : head + parameters],
            data=raw[head + parameters :],
            error=int.from_bytes(raw[10:head], "big"),
        )

    def encoded(self) -> bytes:
        """Return the PDU as it is on the wire."""
        lengths = struct.pack(
            ">BBHHHH", _PROTOCOL, self.rosctr, 0, self.reference, len(self.parameters), len(self.data)
        )
        error = struct.pack(">H", self.error) if self.rosctr in (ACK, ACK_DATA) else b""
        return lengths + error + self.parameters + self.data


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """One variable as a job addresses it: an S7 ANY pointer.

    Attributes:
        transport: type of the elements.
        count: number of elements.
        db: number of the data block, 0 for other areas.
        area: number of the area.
        address: of the first bit.
    """

    transport: int
    count: int
    db: int
    area: int
    address: int

    def described(self) -> dict[str, Any]:
        """Return the members that the journal has of it."""
        return {
            "area": self.area,
            "db": self.db,
            "byte": self.address // 8,
            "bit": self.address % 8,
            "transport": self.transport,
            "count": self.count,
        }


def variables(parameters: bytes) -> list[Variable] | None:
    """Return the variables of a job's parameters; None where these are no list of ANY pointers."""
    if len(parameters) < 2 or len(parameters) != 2 + 12 * parameters[1] or not parameters[1]:
        return None
    found = []
    for start in range(2, len(parameters), 12):
        if parameters[start : start + 3] != _ANY_POINTER:
            return None
        transport, count, db, area = struct.unpack_from(">BHHB", parameters, start + 3)
        address = int.from_bytes(parameters[start + 9 : start + 12])
        found.append(Variable(transport=transport, count=count, db=db, area=area, address=address))
    return found


def written_data(asked: Sequence[Variable], data: bytes) -> list[tuple[int, bytes]] | None:
    """Return transport size and bytes for each variable of a write; None where the data does not add up.

    Data of an odd length is padded to an even one, except for the last.
    """
    found: list[tuple[int, bytes]] = []
    for number in range(len(asked)):
        if len(data) < 4:
            return None
        transport, length = data[1], int.from_bytes(data[2:4])
        size = (length + 7) // 8 if transport in _LENGTH_IN_BITS else length
        if len(data) < 4 + size:
            return None
        found.append((transport, data[4 : 4 + size]))
        data = data[4 + size + (size % 2 if number < len(asked) - 1 else 0) :]
    return None if data else found


def request_fields(pdu: Pdu) -> dict[str, Any]:
    """Return what a request says: the members of its journal entry, see :class:`~pytest_otmcp.protocols.s7.entries.S7Entry`, and
    ``state_changing``.

    Raises:
        MalformedError: it says nothing.
    """
    fields: dict[str, Any] = {"reference": pdu.reference}
    if pdu.rosctr == USER_DATA:
        return fields | _information(pdu.parameters, pdu.data)
    if not pdu.parameters:
        raise MalformedError("it has no parameters")
    function = pdu.parameters[0]
    fields |= {"service": _SERVICES.get(function, "other"), "function": function}
    fields["state_changing"] = function in STATE_CHANGING_JOBS
    asked = variables(pdu.parameters) if function in (READ, WRITE) else None
    if asked is not None:
        fields["items"] = [variable.described() for variable in asked]
        written = written_data(asked, pdu.data) if function == WRITE else None
        for item, (_, content) in zip(fields["items"], written or (), strict=False):
            item["data"] = content.hex()
    return fields


def _information(parameters: bytes, data: bytes) -> dict[str, Any]:
    if len(parameters) not in (8, 12):
        return {"service": "other", "state_changing": False}
    group = parameters[5] & 0x0F, parameters[6]
    fields: dict[str, Any] = {
        "service": _INFORMATION.get(group, "other"),
        "group": group[0],
        "subfunction": group[1],
        "state_changing": group in STATE_CHANGING_USER_DATA,
    }
    if fields["service"] == "szl" and len(data) == 8:
        fields["szl_id"], fields["szl_index"] = struct.unpack_from(">HH", data, 4)
    return fields


def answer_fields(pdu: Pdu) -> dict[str, Any]:
    """Return what an answer says."""
    fields: dict[str, Any] = {"reference": pdu.reference}
    if pdu.rosctr == USER_DATA:
        error = int.from_bytes(pdu.parameters[10:12], "big")
        return fields | {"error": error or None, "code": pdu.data[0] if pdu.data else None, "items": []}
    return fields | {"error": pdu.error or None, "items": _results(pdu.parameters, pdu.data)}


def _results(parameters: bytes, data: bytes) -> list[dict[str, Any]]:
    """Return code and data of each variable that an answer is about."""
    function = parameters[0] if parameters else None
    if function == WRITE:
        return [{"code": code} for code in data]
    found: list[dict[str, Any]] = []
    while function == READ and len(data) >= 4:
        code, transport, length = struct.unpack_from(">BBH", data)
        size = (length + 7) // 8 if transport in (4, 5) else length
        found.append({"code": code, "data": data[4 : 4 + size].hex()} if code == SUCCESS else {"code": code})
        data = data[4 + size + size % 2 :]
    return found
