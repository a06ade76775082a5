"""S7 PDUs: jobs with several variables, and the check that an answer belongs to its request. It handles bytes, no connection.

python-snap7 builds and parses the PDUs. It does not say the error of an answer to user data as a number, the return code of each
variable, or whether an answer is about the service that was asked for; and it writes several variables by as many jobs.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from snap7.datatypes import S7Area, S7WordLen
from snap7.error import S7Error
from snap7.s7protocol import S7Protocol

from ..core import BadReply

__all__ = [
    "SUCCESS",
    "Reply",
    "Variable",
    "items_of",
    "read_job",
    "reference",
    "reply_of",
    "request_facts",
    "write_job",
]

SUCCESS = 0xFF
_HEADER = 10
_USER_DATA = 7
_IN_BITS = (3, 4, 5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """An address: a bit, or so many bytes.

    Attributes:
        area: input, output, flags or a data block.
        db: number of the data block, 0 for other areas.
        bit: of a BOOL; None for bytes.
        size: number of bytes.
    """

    area: S7Area
    db: int
    byte: int
    size: int
    bit: int | None = None

    @property
    def start(self) -> int:
        """Offset as python-snap7 counts it: in bits for a bit."""
        return self.byte if self.bit is None else 8 * self.byte + self.bit

    @property
    def transport(self) -> S7WordLen:
        """Transport size of the address."""
        return S7WordLen.BYTE if self.bit is None else S7WordLen.BIT


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """An answer.

    Attributes:
        error: of the header, or of user data; 0 for none.
        parameters, data: of the PDU.
    """

    error: int
    parameters: bytes
    data: bytes


def reference(pdu: bytes) -> int:
    """Return the PDU reference."""
    return int(struct.unpack_from(">H", pdu, 4)[0]) if len(pdu) >= _HEADER else -1


def read_job(protocol: S7Protocol, variables: Sequence[Variable]) -> bytes:
    """Return one job that reads all variables."""
    jobs = [
        protocol.build_read_request(v.area, v.db, v.start, v.transport, 1 if v.bit is not None else v.size)
        for v in variables
    ]
    return _joined(jobs, [b""] * len(jobs))


def write_job(protocol: S7Protocol, variables: Sequence[Variable], contents: Sequence[bytes]) -> bytes:
    """Return one job that writes all variables."""
    jobs = [
        protocol.build_write_request(v.area, v.db, v.start, v.transport, content)
        for v, content in zip(variables, contents, strict=True)
    ]
    return _joined(jobs, [job[24:] for job in jobs])


def _joined(jobs: Sequence[bytes], data: Sequence[bytes]) -> bytes:
    """Return the job that has the variables of several, each with 14 bytes of parameters."""
    parameters = bytes([jobs[0][_HEADER], len(jobs)]) + b"".join(job[12:24] for job in jobs)
    # Data of an odd length is padded, except for the last.
    content = b"".join(part + bytes(len(part) % 2) for part in data[:-1]) + data[-1]
    return jobs[-1][:6] + struct.pack(">HH", len(parameters), len(content)) + parameters + content


def request_facts(request: bytes) -> dict[str, object]:
    """Return what a request gives ``meta.trace`` to say: function, and area, db and start of its first variable."""
    facts: dict[str, object] = {"function": request[_HEADER]}
    if request[1] == _USER_DATA:
        return {"group": request[15] & 0x0F, "subfunction": request[16]}
    if request[_HEADER] in (4, 5):
        db, area = struct.unpack_from(">HB", request, 18)
        facts |= {"area": area, "db": db, "start": int.from_bytes(request[21:24], "big") // 8}
    return facts


def reply_of(protocol: S7Protocol, request: bytes, answer: bytes) -> Reply:
    """Return the parts of an answer, which has the request's PDU reference.

    Raises:
        BadReply: it is no answer to this request.
    """
    jobs = request[1] != _USER_DATA
    if len(answer) < 12 or answer[0] != 0x32 or answer[1] not in ((2, 3) if jobs else (2, 3, _USER_DATA)):
        raise BadReply("it is no acknowledgement")
    if answer[1] != _USER_DATA and (error := int.from_bytes(answer[10:12], "big")):
        return Reply(error=error, parameters=b"", data=b"")
    parameters, data = struct.unpack_from(">HH", answer, 6)
    head = _HEADER if answer[1] == _USER_DATA else _HEADER + 2
    if len(answer) != head + parameters + data:
        raise BadReply("its lengths do not fit")
    reply = Reply(error=0, parameters=answer[head : head + parameters], data=answer[head + parameters :])
    if jobs:
        if reply.parameters[:1] != request[_HEADER : _HEADER + 1]:
            raise BadReply("it is the answer to another function")
        return reply
    if answer[1] != _USER_DATA or len(reply.parameters) != 12:
        raise BadReply("it is no answer to user data")
    if (reply.parameters[5] & 0x0F, reply.parameters[6]) != (request[15] & 0x0F, request[16]):
        raise BadReply("it is the answer to another service")
    if error := int.from_bytes(reply.parameters[10:12], "big"):
        return Reply(error=error, parameters=reply.parameters, data=b"")
    try:
        protocol.parse_response(answer)
    except S7Error:
        code = reply.data[0] if reply.data else SUCCESS
        if code == SUCCESS:
            raise BadReply("its content does not fit") from None
    return reply


def items_of(request: bytes, reply: Reply) -> list[tuple[int, bytes]]:
    """Return the return code of each variable of a job, and what was read.

    Raises:
        BadReply: the answer is about another number of variables, or of bytes, than were asked for.
    """
    count, rest = request[11], reply.data
    if reply.parameters[1:] != bytes([count]):
        raise BadReply("it is about another number of variables")
    if request[_HEADER] == 5:
        if len(rest) != count:
            raise BadReply("it has another number of return codes")
        return [(code, b"") for code in rest]
    found: list[tuple[int, bytes]] = []
    for number in range(count):
        if len(rest) < 4:
            raise BadReply("it is cut off")
        code, transport, length = struct.unpack_from(">BBH", rest)
        size = 0 if code != SUCCESS else (length + 7) // 8 if transport in _IN_BITS else length
        expected = int.from_bytes(request[16 + 12 * number : 18 + 12 * number], "big")
        if code == SUCCESS and (size != expected or len(rest) < 4 + size):
            raise BadReply("it has another number of bytes than were asked for")
        found.append((code, rest[4 : 4 + size]))
        rest = rest[4 + size + (size % 2 if number < count - 1 else 0) :]
    if rest:
        raise BadReply("bytes follow its last variable")
    return found
