"""The bytes of PROFINET, as far as a controller needs them: DCP, remote procedure calls, blocks, cyclic frames (IEC 61158-6-10)."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from ..core import AdapterError, BadReply

__all__ = [
    "ETHERTYPE",
    "IDENTIFY",
    "IP",
    "MULTICAST",
    "NAME",
    "RESULT",
    "SET",
    "SIGNAL",
    "Answer",
    "Discovered",
    "Request",
    "block",
    "blocks_in",
    "control",
    "cyclic_frame",
    "dcp",
    "dcp_answer",
    "layout",
    "record_header",
    "rpc_answer",
]

ETHERTYPE = 0x8892
MULTICAST = bytes.fromhex("010ecf000000")
GET_SET, IDENTIFY_REQUEST = 0xFEFD, 0xFEFE
SET, IDENTIFY = 4, 5
IP, VENDOR, NAME, IDS, SIGNAL, RESULT = (1, 2), (2, 1), (2, 2), (2, 3), (5, 3), (5, 4)
"""Options of DCP with their suboptions."""
CONNECT, RELEASE, READ, WRITE, CONTROL, READ_IMPLICIT = range(6)
"""Operations of remote procedure calls."""
_DEVICE, _CONTROLLER = (
    bytes.fromhex("dea000016c9711d1827100a02442df7d"),
    bytes.fromhex("dea000026c9711d1827100a02442df7d"),
)
_OBJECT = bytes.fromhex("dea000006c9711d18271")
_REQUEST, _RESPONSE, _FAULT, _REJECT = 0, 2, 3, 6
_DCP = struct.Struct(">HBBIHH")
_GOOD, _RUNNING = 0x80, 0x35
_LEAST_DATA = 40


# -- DCP ------------------------------------------------------------------------------------------------------


def dcp(service: int, xid: int, *options: tuple[tuple[int, int], bytes]) -> bytes:
    """Return a request, from the frame identifier on."""
    body = b""
    for option, content in options:
        body += bytes(option) + len(content).to_bytes(2) + content + bytes(len(content) % 2)
    identifies = service == IDENTIFY
    return _DCP.pack(IDENTIFY_REQUEST if identifies else GET_SET, service, 0, xid, int(identifies), len(body)) + body


@dataclass(frozen=True, slots=True)
class Discovered:
    """A message of DCP from a station: who it is from, its transaction, and its options."""

    mac: bytes
    xid: int
    options: Mapping[tuple[int, int], bytes]


def dcp_answer(frame: bytes) -> Discovered | None:
    """Return the answer that a frame is; None for another frame, and for one that is cut off."""
    if len(frame) < 26 or frame[14] != 0xFE:
        return None
    _, _, kind, xid, _, length = _DCP.unpack_from(frame, 14)
    body = frame[26 : 26 + length]
    if kind == 0 or len(body) < length:
        return None
    options: dict[tuple[int, int], bytes] = {}
    at = 0
    while at + 4 <= len(body):
        size = int.from_bytes(body[at + 2 : at + 4])
        if at + 4 + size > len(body):
            return None
        options[body[at], body[at + 1]] = body[at + 4 : at + 4 + size]
        at += 4 + size + size % 2
    return Discovered(frame[6:12], xid, options)


# -- remote procedure calls -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Request:
    """One call of a device; sent again it is the same call, and not executed twice.

    Attributes:
        operation: see above.
        blocks: its arguments.
        vendor, device: identifiers of the device.
        activity: by which the answer is known.
    """

    operation: int
    blocks: bytes
    vendor: int
    device: int
    activity: bytes = field(default_factory=lambda: os.urandom(16))

    def encoded(self) -> bytes:
        """Return the datagram."""
        length = len(self.blocks)
        body = struct.pack(">5I", 4100, length, 4100, 0, length) + self.blocks
        who = _OBJECT + struct.pack(">HHH", 1, self.device, self.vendor) + _DEVICE + self.activity
        numbers = struct.pack(">IIIHHHHHBB", 0, 1, 0, self.operation, 0xFFFF, 0xFFFF, len(body), 0, 0, 0)
        return bytes([4, _REQUEST, 0x20, 0, 0, 0, 0, 0]) + who + numbers + body


@dataclass(frozen=True, slots=True)
class Answer:
    """A datagram that came: whose activity it belongs to, whether it asks, and what it says.

    Attributes:
        asks: it is a request of the device.
        refused: the device has no such interface, or failed; the text says which.
        status: PNIO status; 0 for success.
        blocks: results.
        head: of a request, to be repeated in the answer.
    """

    activity: bytes
    asks: bool
    refused: str | None
    status: int
    blocks: bytes
    head: bytes


def rpc_answer(data: bytes) -> Answer:
    """Read a datagram.

    Raises:
        BadReply: it is no call and no answer.
    """
    if len(data) < 80 or data[0] != 4:
        raise BadReply("no remote procedure call")
    order = "<" if data[4] >> 4 else ">"
    kind, activity = data[1], data[40:56]
    if kind in (_FAULT, _REJECT):
        return Answer(activity, False, "a fault" if kind == _FAULT else "no such interface", 0, b"", b"")
    if kind not in (_REQUEST, _RESPONSE) or len(data) < 100:
        raise BadReply(f"a packet of the type {kind}")
    (sequence,) = struct.unpack_from(f"{order}I", data, 64)
    status, length = struct.unpack_from(f"{order}II", data, 80)
    blocks = data[100 : 100 + length]
    if len(blocks) < length:
        raise BadReply("results that are cut off")
    if kind == _RESPONSE and sequence:
        raise BadReply("an answer with another number than the call's")
    return Answer(activity, kind == _REQUEST, None, status if kind == _RESPONSE else 0, blocks, data[:80])


def acknowledged(asked: Answer, blocks: bytes) -> bytes:
    """Return the datagram that answers a request of the device."""
    order = "<" if asked.head[4] >> 4 else ">"
    length = len(blocks)
    body = struct.pack(f"{order}5I", 0, length, length, 0, length) + blocks
    head = bytearray(asked.head)
    head[1], head[2] = _RESPONSE, 0x0A
    struct.pack_into(f"{order}H", head, 74, len(body))
    return bytes(head) + body


# -- blocks -----------------------------------------------------------------------------------------------------


def block(kind: int, body: bytes) -> bytes:
    """Return a block of version 1.0."""
    return struct.pack(">HHBB", kind, len(body) + 2, 1, 0) + body


def blocks_in(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Return the types and bodies of blocks.

    Raises:
        AdapterError: one is cut off.
    """
    at = 0
    while at < len(data):
        if len(data) < at + 6:
            raise AdapterError("protocol_error", "the device answered with a block that is cut off")
        kind, length = struct.unpack_from(">HH", data, at)
        if length < 2 or at + 4 + length > len(data):
            raise AdapterError("protocol_error", "the device answered with a block that is cut off")
        yield kind, data[at + 6 : at + 4 + length]
        at += 4 + length


def record_header(kind: int, relation: bytes, slot: int, subslot: int, index: int, length: int) -> bytes:
    """Return the header of a request to read (0009) or write (0008) a record."""
    return block(kind, struct.pack(">H16sIHHHHI24s", 0, relation, 0, slot, subslot, 0, index, length, b""))


def control(kind: int, relation: bytes, command: int) -> bytes:
    """Return a step in the life of a relation."""
    return block(kind, struct.pack(">H16sHHHH", 0, relation, 1, 0, command, 0))


def relation(kind: int, identifier: bytes, mac: bytes) -> bytes:
    """Return what a relation begins with: 1 with cyclic data, 6 of a supervisor."""
    own = _OBJECT + b"\0\1\0\1\0\1"
    return block(
        0x0101, struct.pack(">H16sH6s16sIHHH", kind, identifier, 1, mac, own, 0x11, 100, ETHERTYPE, 7) + b"adapter"
    )


# -- cyclic data ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the data of each subslot are in the frames of one direction, and where its status as a consumer is.

    Attributes:
        kind: 1 for inputs, 2 for outputs.
        data, consumed: by slot and subslot.
        length: bytes of a frame's data.
    """

    kind: int
    data: Mapping[tuple[int, int], int]
    consumed: Mapping[tuple[int, int], int]
    length: int

    def block(self, frame_id: int, ratio: int, watchdog: int) -> bytes:
        """Return the block that asks for these frames."""
        head = (
            self.kind,
            self.kind,
            ETHERTYPE,
            1,
            self.length,
            frame_id,
            32,
            ratio,
            1,
            0,
            0xFFFFFFFF,
            watchdog,
            watchdog,
        )
        body = struct.pack(">HHHIHHHHHHIHH", *head) + struct.pack(">H6sHI", 0xC000, bytes(6), 1, 0)
        for places in (self.data, self.consumed):
            body += len(places).to_bytes(2)
            body += b"".join(struct.pack(">HHH", *place, offset) for place, offset in places.items())
        return block(0x0102, body)


def layout(kind: int, lengths: Mapping[tuple[int, int], tuple[int, int]]) -> Layout:
    """Lay the frames of one direction out, for subslots with so many bytes of inputs and of outputs."""
    data, consumed, at = {}, {}, 0
    for place, (inputs, outputs) in lengths.items():
        size = inputs if kind == 1 else outputs
        # What has neither inputs nor outputs provides its status with the inputs.
        if size or (kind == 1 and not outputs):
            data[place] = at
            at += size + 1
    for place, (inputs, outputs) in lengths.items():
        if (outputs if kind == 1 else inputs) or (kind == 2 and not outputs):
            consumed[place] = at
            at += 1
    return Layout(kind, data, consumed, max(at, _LEAST_DATA))


def cyclic_frame(frame_id: int, outputs: Layout, values: Mapping[tuple[int, int], bytes], counter: int) -> bytes:
    """Return a frame with outputs, from the frame identifier on."""
    data = bytearray(outputs.length)
    for place, at in outputs.data.items():
        content = values.get(place, b"")
        data[at : at + len(content) + 1] = content + bytes([_GOOD])
    for at in outputs.consumed.values():
        data[at] = _GOOD
    return frame_id.to_bytes(2) + bytes(data) + struct.pack(">HBB", counter & 0xFFFF, _RUNNING, 0)
