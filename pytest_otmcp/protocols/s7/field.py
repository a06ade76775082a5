"""What the kit may do at a real S7 controller: read bytes of a data block. It writes nothing there."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ...core.finding import Finding
from ...wire.framing import MalformedError
from ...wire.s7 import (
    CLOCK,
    CONNECT_REQUEST,
    DATA,
    DISCONNECT_REQUEST,
    JOB,
    READ,
    SETUP,
    SZL,
    USER_DATA,
    Connect,
    Pdu,
    tpkt_length,
    variables,
)
from ..exercise import Asked
from ..field import Field
from ..journal import Entries, Image
from .entries import as_s7, points
from .oracle import read_from_device

__all__ = ["FIELD"]

_WHOLE = 0x80
"""A TPDU that is all of its PDU; what a controller makes of parts cannot be told from one of them."""
_SETUP_LENGTH, _REQUEST = 8, 4
_METHOD = {8: b"\x11", 12: b"\x12"}
"""Length of the parameters of user data to their method: a request, and one for the rest of a long answer."""
_ASKED = {SZL: 8, CLOCK: 4}
"""User data that only asks, to the longest data of its request."""
_APART = 3


def _harmless(frame: bytes) -> bool:
    tpdu = frame[4:]
    if tpkt_length(frame) != len(frame):
        return False
    if tpdu[1] == CONNECT_REQUEST:
        # Whatever comes behind the parameters is no request.
        return bool(Connect.parse(tpdu))
    if tpdu[1] == DISCONNECT_REQUEST:
        return tpdu[0] == len(tpdu) - 1
    if tpdu[:3] != bytes([2, DATA, _WHOLE]):
        return False
    try:
        pdu = Pdu.parse(tpdu[3:])
    except MalformedError:
        return False
    if pdu.rosctr == JOB:
        if pdu.data:
            return False
        function, length = pdu.parameters[0], len(pdu.parameters)
        return (function == SETUP and length == _SETUP_LENGTH) or (
            function == READ and variables(pdu.parameters) is not None
        )
    parameters = pdu.parameters
    if pdu.rosctr != USER_DATA or parameters[4:5] != _METHOD.get(len(parameters)) or parameters[5] >> 4 != _REQUEST:
        return False
    return len(pdu.data) <= _ASKED.get((parameters[5] & 0x0F, parameters[6]), -1)


def _place(point: str) -> tuple[int, int]:
    """Return the number of the data block and of the byte."""
    block, _, byte = point.removeprefix("DB").partition(".DBB")
    return int(block), int(byte)


def _reads(image: Image, claims: Callable[[str], bool]) -> list[Asked]:
    found: dict[int, int] = {}
    for point, value in image["points"].items():
        db, byte = _place(point)
        found[byte] = value
    first_with = {value: byte for byte, value in sorted(found.items(), reverse=True)}
    chosen = sorted(first_with.values())[:_APART]
    reads = [_bytes(db, byte, [found[byte]]) for byte in chosen] if claims("read_db") else []
    if claims("read_typed"):
        reads += [
            Asked(
                operation="read_typed",
                inputs={"db": db, "start": byte, "type": "BYTE"},
                outputs={"value": found[byte]},
                points=points(f"DB{db}", byte, bytes([found[byte]])),
            )
            for byte in chosen
        ]
    block = [found[byte] for byte in range(chosen[0], chosen[0] + 4) if byte in found] if chosen else []
    return [*reads, *([_bytes(db, chosen[0], block)] if len(block) == 4 and claims("read_db") else [])]


def _bytes(db: int, start: int, values: Sequence[int]) -> Asked:
    return Asked(
        operation="read_db",
        inputs={"db": db, "start": start, "size": len(values)},
        outputs={"values": list(values)},
        points=points(f"DB{db}", start, bytes(values)),
    )


def _beyond(image: Image, claims: Callable[[str], bool]) -> Asked | None:
    missing = image["beyond"].get("db")
    if missing is None:
        return None
    if claims("read_typed"):
        return Asked(operation="read_typed", inputs={"db": missing, "start": 0, "type": "BYTE"})
    return Asked(operation="read_db", inputs={"db": missing, "start": 0, "size": 1}) if claims("read_db") else None


def _was_read(entries: Entries, asked: Asked) -> list[Finding]:
    db, start = _place(next(iter(asked.points)))
    return read_from_device(entries, db=db, start=start, size=len(asked.points))


def _sent(entries: Entries) -> list[int]:
    items = (item for entry in entries if entry["kind"] == "response" for item in as_s7(entry).get("items", []))
    return [byte for item in items for byte in bytes.fromhex(item.get("data", ""))]


FIELD = Field(
    harmless=_harmless,
    reads=_reads,
    beyond=_beyond,
    was_read=_was_read,
    sent=_sent,
)
