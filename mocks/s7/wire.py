"""Frames and PDUs of classic S7 communication: TPKT (RFC 1006), COTP class 0 (X.224), S7 header. It handles bytes only.

S7 itself was never published; the layout is the one that is publicly known, as Wireshark shows it.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from pytest_otmcp.wire.framing import MalformedError

__all__ = [
    "ACK",
    "ACK_DATA",
    "CONNECT_CONFIRM",
    "CONNECT_REQUEST",
    "DATA",
    "DISCONNECT_REQUEST",
    "JOB",
    "USERDATA",
    "Connect",
    "Pdu",
    "confirm",
    "data_frame",
    "frame_length",
    "refuse",
]

CONNECT_REQUEST, CONNECT_CONFIRM, DISCONNECT_REQUEST, DATA = 0xE0, 0xD0, 0x80, 0xF0
JOB, ACK, ACK_DATA, USERDATA = 1, 2, 3, 7

_VERSION = 3
_SHORTEST = 7
_TPDU_SIZE, _CALLING, _CALLED = 0xC0, 0xC1, 0xC2
_LARGEST_TPDU = 0x0A
"""2 to this power, 1024 bytes: more than any PDU here, so that no PDU is cut into several TPDUs."""
_OUR_REFERENCE = 0x0001
_ADDRESS_UNKNOWN = 3


def frame_length(buffer: bytes | bytearray) -> int | None:
    """Return the length of the TPKT at the beginning of the buffer; None while too little of it has arrived.

    Raises:
        MalformedError: no TPKT begins like that.
    """
    if buffer and buffer[0] != _VERSION:
        raise MalformedError(f"TPKT: version {buffer[0]}")
    if len(buffer) < 4:
        return None
    length = int.from_bytes(buffer[2:4])
    if length < _SHORTEST:
        raise MalformedError(f"TPKT: length {length}")
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
        called = found.get(_CALLED, b"")
        if len(called) != 2:
            raise MalformedError("COTP: a connection request without a called TSAP of two bytes")
        return cls(reference=int.from_bytes(tpdu[4:6]), calling=found.get(_CALLING, b""), called=called)

    @property
    def rack(self) -> int:
        """Rack that is called."""
        return self.called[1] >> 5

    @property
    def slot(self) -> int:
        """Slot that is called."""
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
        """Read a client's PDU.

        Raises:
            MalformedError: its header does not fit.
        """
        if len(raw) < 10 or raw[0] != 0x32 or raw[1] not in (JOB, USERDATA):
            raise MalformedError("S7: no header of a job or of user data")
        reference, parameters, data = struct.unpack_from(">HHH", raw, 4)
        if len(raw) != 10 + parameters + data or not parameters:
            raise MalformedError(f"S7: {len(raw)} bytes with {parameters} of parameters and {data} of data")
        return cls(
            rosctr=raw[1], reference=reference, parameters=raw[10 : 10 + parameters], data=raw[10 + parameters :]
        )

    def encoded(self) -> bytes:
        """Return the PDU as it is on the wire."""
        lengths = struct.pack(">BBHHHH", 0x32, self.rosctr, 0, self.reference, len(self.parameters), len(self.data))
        error = struct.pack(">H", self.error) if self.rosctr in (ACK, ACK_DATA) else b""
        return lengths + error + self.parameters + self.data
