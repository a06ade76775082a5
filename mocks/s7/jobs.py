"""The execution of jobs and user data on the controller. It handles PDUs and memory, no sockets.

Every request is answered: by return codes of its variables, by an error of the header (jobs) or of the parameters (user data).
"""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass
from datetime import UTC, datetime

from pytest_otmcp.wire.s7 import (
    ACK_DATA,
    CLOCK,
    READ,
    SET_CLOCK,
    SETUP,
    SUCCESS,
    SZL,
    USER_DATA,
    WRITE,
    Pdu,
    variables,
    written_data,
)

from .faults import Rule
from .image import Plant
from .items import read_answer, store
from .szl import system_status

__all__ = ["Session", "execute"]

CONTROL, STOP = 0x28, 0x29

NOT_ALLOWED, WRONG_PDU, NOT_AVAILABLE = 0x8104, 0x8500, 0xD401
WRONG_STATE = 0x8402
_PROGRAM = b"P_PROGRAM"
_MOST_ITEMS = 20
_SMALLEST_PDU = 240
_PERMANENT = b"\x00\x01\x12\x08\x12"


@dataclass(slots=True, kw_only=True)
class Session:
    """What the controller remembers of one connection.

    Attributes:
        pdu_size: as agreed to; 0 before.
        rest: what is left of an answer that does not fit into one PDU, and the number of its sequence.
    """

    pdu_size: int = 0
    rest: bytes = b""
    sequence: int = 0


def _group(request: Pdu) -> tuple[int, int] | None:
    """Return function group and subfunction of user data; None where its parameters are none."""
    head = request.parameters
    if len(head) not in (8, 12) or head[2] != 0x12 or head[3] != len(head) - 4:
        return None
    # The upper half says that it is a request, 4; pyS7 says 0, and real controllers are reported to answer it.
    if head[5] >> 4 not in (0, 4):
        return None
    return head[5] & 0x0F, head[6]


def execute(plant: Plant, session: Session, request: Pdu, rule: Rule | None) -> Pdu:
    """Execute a request and return its answer."""
    if request.rosctr == USER_DATA:
        return _user_data(plant, session, request, rule)
    function = request.parameters[0]
    error, parameters, data = 0, bytes([function]), b""
    if rule is not None and rule.error is not None:
        error = rule.error
    elif function == SETUP:
        error, parameters = _set_up(plant, session, request)
    elif function in (READ, WRITE):
        error, parameters, data = _access(plant, session, request, rule)
    elif function in (CONTROL, STOP):
        error = _control(plant, request, apply=rule is None or not rule.ack_only)
    else:
        error = NOT_ALLOWED
    if error:
        return Pdu(rosctr=ACK_DATA, reference=request.reference, parameters=b"", error=error)
    return Pdu(rosctr=ACK_DATA, reference=request.reference, parameters=parameters, data=data)


def _set_up(plant: Plant, session: Session, request: Pdu) -> tuple[int, bytes]:
    if len(request.parameters) != 8:
        return WRONG_PDU, b""
    calling, called, wanted = struct.unpack_from(">HHH", request.parameters, 2)
    session.pdu_size = max(_SMALLEST_PDU, min(wanted, plant.pdu_size))
    return 0, struct.pack(">BBHHH", SETUP, 0, min(calling, 1), min(called, 1), session.pdu_size)


def _access(plant: Plant, session: Session, request: Pdu, rule: Rule | None) -> tuple[int, bytes, bytes]:
    function = request.parameters[0]
    asked = variables(request.parameters)
    if asked is None or len(asked) > _MOST_ITEMS:
        return WRONG_PDU, b"", b""
    if not plant.put_get:
        return NOT_ALLOWED, b"", b""
    count = len(asked)
    forced = None if rule is None else rule.return_code
    if function == READ:
        if request.data:
            return WRONG_PDU, b"", b""
        instead, longer = (None, 0) if rule is None else (rule.answer_data, rule.data_length)
        data = read_answer(plant, asked, forced, instead, longer)
        # An answer that does not fit is none at all; what a fault makes of it is sent as it is.
        if 14 + len(data) > session.pdu_size and instead is None:
            return WRONG_PDU, b"", b""
        return 0, bytes([function, count]), data
    written = written_data(asked, request.data)
    if written is None:
        return WRONG_PDU, b"", b""
    apply = rule is None or not rule.ack_only
    codes = [
        store(plant, variable, transport, content, apply=apply) if forced is None else forced
        for variable, (transport, content) in zip(asked, written, strict=True)
    ]
    return 0, bytes([function, count]), bytes(codes)


def _control(plant: Plant, request: Pdu, *, apply: bool) -> int:
    """Start or stop the program. Parameters: function, reserved bytes, a block of arguments, name of the service."""
    body = request.parameters
    start = body[0] == CONTROL
    name = body[-1 - len(_PROGRAM) :]
    if name != bytes([len(_PROGRAM)]) + _PROGRAM:
        return NOT_ALLOWED
    if plant.running == start:
        return WRONG_STATE
    if apply:
        plant.running = start
    return 0


def _user_data(plant: Plant, session: Session, request: Pdu, rule: Rule | None) -> Pdu:
    group = _group(request)
    if group is None:
        return Pdu(rosctr=ACK_DATA, reference=request.reference, parameters=b"", error=WRONG_PDU)
    error, content = 0, b""
    if rule is not None and rule.error is not None:
        error = rule.error
    elif group == SZL and len(request.parameters) == 12:
        # The client asks for the next part of an answer.
        content, error = session.rest, 0 if session.rest else NOT_AVAILABLE
    elif group == SZL:
        found = system_status(plant, *struct.unpack_from(">HH", request.data, 4)) if len(request.data) == 8 else None
        content, error = (b"", NOT_AVAILABLE) if found is None else (found, 0)
    elif group == CLOCK:
        content = _clock()
    elif group != SET_CLOCK:
        error = NOT_AVAILABLE
    if rule is not None and rule.answer_data is not None and not error:
        content = rule.answer_data
    most = session.pdu_size - 26
    content, session.rest = content[:most], content[most:]
    session.sequence = (session.sequence + 1) & 0xFF if session.rest or len(request.parameters) == 12 else 0
    kind = 0x80 | group[0]
    status = struct.pack(">BBBBBH", kind, group[1], session.sequence, 0, bool(session.rest), error)
    forced = None if rule is None else rule.return_code
    code = forced if forced is not None else SUCCESS if content else 0x0A
    shown = content if forced is None else b""
    data = struct.pack(">BBH", code, 9 if shown else 0, len(shown)) + shown
    return Pdu(rosctr=USER_DATA, reference=request.reference, parameters=_PERMANENT + status, data=data)


def _clock() -> bytes:
    """Return the present time as the controller tells it: BCD digits, and the day of the week, 1 for Sunday."""
    now = datetime.fromtimestamp(time.time(), UTC)
    digits = now.strftime("%y%m%d%H%M%S") + f"{now.microsecond // 1000:03}" + str(now.isoweekday() % 7 + 1)
    return bytes([0, 0x19]) + bytes.fromhex(digits)
