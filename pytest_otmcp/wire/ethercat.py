"""The codec of EtherCAT: datagrams of a frame (IEC 61158-4-12, ETG.1000.4), and the CANopen objects in their mailboxes (ETG.1000.6, CiA 301).

A frame of the EtherType ``88A4`` has a header of two bytes, whose lower eleven bits are the length, and datagrams in a row, each with a
working counter that every slave counts up which has done what it asks for. All numbers have the least significant byte first.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from .framing import MalformedError

__all__ = [
    "ADDRESS_OF",
    "AL_CONTROL",
    "AL_STATUS",
    "ETHERTYPE",
    "INPUTS",
    "LOGICAL",
    "MAILBOX_BYTES",
    "MAILBOX_IN",
    "MAILBOX_OUT",
    "OUTPUTS",
    "READS",
    "SERVICES",
    "STATES",
    "STATE_BITS",
    "WRITES",
    "Datagram",
    "Sdo",
    "encoded",
    "fields_of",
    "has_counter",
    "parse",
    "sdo_of",
]

ETHERTYPE = 0x88A4
ADDRESS_OF = {
    **dict.fromkeys((1, 2, 3), "position"),
    **dict.fromkeys((4, 5, 6), "station"),
    **dict.fromkeys((7, 8, 9), "all"),
}
"""Commands to the kind of address that they have: the position on the line, a station address, none."""
READS, WRITES = frozenset({1, 3, 4, 6, 7, 9, 10, 12}), frozenset({2, 3, 5, 6, 8, 9, 11, 12})
"""Commands that read memory of slaves, and that write it."""
LOGICAL = frozenset({10, 11, 12})
"""Commands whose address is one of the process image: LRD, LWR, LRW."""
AL_CONTROL, AL_STATUS = 0x0120, 0x0130
"""Registers of the state machine."""
MAILBOX_OUT, MAILBOX_IN, MAILBOX_BYTES = 0x1000, 0x1080, 0x80
"""Where the kit's slaves have their mailboxes: what masters write, what they read, and the size of each."""
OUTPUTS, INPUTS = 0x1100, 0x1180
"""Where the kit's slaves have their process data."""
STATES = {1: "INIT", 2: "PREOP", 3: "BOOT", 4: "SAFEOP", 8: "OP"}
STATE_BITS = 0x0F
SERVICES = ("scan", "al_status", "state", "sdo_upload", "sdo_download", "inputs", "process_data", "other")
"""Names of what a datagram asks for, as the journal and fault rules have them."""

_ETHERNET = 14
_HEADER = struct.Struct("<BBHHHH")
_LENGTH, _MORE = 0x07FF, 0x8000
_COMMANDS = 15
_COE, _SDO_REQUEST, _SDO_RESPONSE = 3, 2, 3
_UPLOAD, _DOWNLOAD = 2, 1
_ABORT = 0x80


@dataclass(slots=True, kw_only=True)
class Datagram:
    """One datagram.

    Attributes:
        command: its number, 1 to 14.
        index: that the master gave it.
        position: of a slave counted down to 0, or its station address; the lower half of a logical address.
        offset: address in the slave's memory; the upper half of a logical address.
        data: its bytes.
        counter: the working counter.
    """

    command: int
    index: int
    position: int
    offset: int
    data: bytes
    counter: int = 0

    @property
    def logical(self) -> int:
        """Address in the process image."""
        return self.position | self.offset << 16

    def covers(self, address: int) -> bool:
        """Tell whether it is about the byte at an address of a slave's memory."""
        return self.command in ADDRESS_OF and self.offset <= address < self.offset + len(self.data)


def parse(frame: bytes) -> list[Datagram]:
    """Return the datagrams of a frame, which begins with its destination address.

    Raises:
        MalformedError: it is no frame of EtherCAT.
    """
    if len(frame) < _ETHERNET + 2 or int.from_bytes(frame[12:14]) != ETHERTYPE:
        raise MalformedError("no EtherCAT frame")
    header = int.from_bytes(frame[14:16], "little")
    content = frame[16 : 16 + (header & _LENGTH)]
    if header >> 12 != 1 or len(content) < header & _LENGTH:
        raise MalformedError("the frame is cut off, or not one of datagrams")
    found, at, more = [], 0, True
    while more:
        if len(content) < at + _HEADER.size:
            raise MalformedError("a datagram is cut off")
        command, index, position, offset, length, _ = _HEADER.unpack_from(content, at)
        end = at + _HEADER.size + (length & _LENGTH)
        if len(content) < end + 2 or not 0 <= command < _COMMANDS:
            raise MalformedError("a datagram is cut off, or has no known command")
        (counter,) = struct.unpack_from("<H", content, end)
        data = content[at + _HEADER.size : end]
        found.append(
            Datagram(command=command, index=index, position=position, offset=offset, data=data, counter=counter)
        )
        at, more = end + 2, bool(length & _MORE)
    return found


def encoded(ethernet: bytes, datagrams: Sequence[Datagram]) -> bytes:
    """Return a frame with these datagrams behind the first fourteen bytes of Ethernet."""
    content = b""
    for number, one in enumerate(datagrams, start=1):
        length = len(one.data) | (_MORE if number < len(datagrams) else 0)
        content += _HEADER.pack(one.command, one.index, one.position, one.offset, length, 0)
        content += one.data + struct.pack("<H", one.counter & 0xFFFF)
    return ethernet[:_ETHERNET] + struct.pack("<H", len(content) | 0x1000) + content


@dataclass(frozen=True, slots=True, kw_only=True)
class Sdo:
    """A request for an object of a slave's dictionary, or the answer to one.

    Attributes:
        service: ``sdo_upload`` and ``sdo_download`` of a request; ``response`` or ``abort`` of an answer; ``other``.
        index, subindex: of the object.
        data: its value, as far as the message has one.
        abort: the abort code; None where there is none.
        counter: of the mailbox, which tells a message from its repetition.
    """

    service: str
    index: int
    subindex: int
    data: bytes = b""
    abort: int | None = None
    counter: int = 0

    def mailbox(self) -> bytes:
        """Return an answer as the mailbox has it."""
        place = struct.pack("<HB", self.index, self.subindex)
        number = _SDO_RESPONSE
        if self.abort is not None:
            number, body = _SDO_REQUEST, bytes([_ABORT]) + place + struct.pack("<I", self.abort)
        elif self.service == "sdo_download":
            body = b"\x60" + place + bytes(4)
        elif 1 <= len(self.data) <= 4:
            body = bytes([0x43 | 4 - len(self.data) << 2]) + place + self.data.ljust(4, b"\0")
        else:
            body = b"\x41" + place + struct.pack("<I", len(self.data)) + self.data
        body = struct.pack("<H", number << 12) + body
        return struct.pack("<HHBB", len(body), 0, 0, _COE | self.counter << 4) + body


def sdo_of(mailbox: bytes) -> Sdo | None:
    """Return what a mailbox says of an object; None where it has nothing of CANopen over EtherCAT."""
    if len(mailbox) < 16 or mailbox[5] & 0x0F != _COE:
        return None
    (length,) = struct.unpack_from("<H", mailbox)
    body, counter = mailbox[6 : 6 + length], mailbox[5] >> 4 & 7
    if len(body) < 10:
        return None
    number, command = int.from_bytes(body[:2], "little") >> 12, body[2]
    index, subindex = struct.unpack_from("<HB", body, 3)
    service, data, abort = "other", b"", None
    if command == _ABORT:
        service, (abort,) = "abort", struct.unpack_from("<I", body, 6)
    elif number == _SDO_REQUEST and command >> 5 == _UPLOAD:
        service = "sdo_upload"
    elif number in (_SDO_REQUEST, _SDO_RESPONSE):
        if number == _SDO_RESPONSE:
            service = "response"
        elif command >> 5 == _DOWNLOAD:
            service = "sdo_download"
        if service != "other" and not (service == "response" and command >> 5 == 3):
            data = _value(body, command)
    return Sdo(service=service, index=index, subindex=subindex, data=data, abort=abort, counter=counter)


def has_counter(mailbox: bytes) -> bool:
    """Tell whether a mailbox has a counter, by which the slave knows one that is sent once more; without, it is 0."""
    return bool(mailbox[5] >> 4 & 7)


def _value(body: bytes, command: int) -> bytes:
    if command & 2:
        return body[6 : 10 - (command >> 2 & 3 if command & 1 else 0)]
    (size,) = struct.unpack_from("<I", body, 6)
    return body[10 : 10 + size]


def fields_of(datagram: Datagram) -> dict[str, Any] | None:
    """Return what a request asks for, as members of a journal entry; None for what is no matter of the journal: how a master sets up its
    slaves before their process data is exchanged, which every master does."""
    kind = ADDRESS_OF.get(datagram.command)
    told: dict[str, Any] = {"command": datagram.command}
    if kind == "station":
        told["station"] = datagram.position
    if datagram.command in LOGICAL:
        return {**told, "service": "process_data", "logical": datagram.logical, "data": datagram.data.hex()}
    if kind is None:
        return None
    if datagram.command in WRITES and datagram.covers(MAILBOX_OUT + MAILBOX_BYTES - 1):
        sdo = sdo_of(datagram.data)
        return None if sdo is None else {**told, "service": sdo.service, **_of_object(sdo)}
    if datagram.command in WRITES and datagram.covers(AL_CONTROL):
        wanted = datagram.data[AL_CONTROL - datagram.offset]
        return {**told, "service": "state", "state": STATES.get(wanted & STATE_BITS, "none")}
    if datagram.command in READS and datagram.covers(AL_STATUS):
        return {**told, "service": "al_status"}
    if datagram.command in READS and datagram.covers(INPUTS):
        return {**told, "service": "inputs"}
    if datagram.command in READS and datagram.offset == 0:
        return {**told, "service": "scan"}
    return None


def _of_object(sdo: Sdo) -> dict[str, Any]:
    return {"index": sdo.index, "subindex": sdo.subindex, "data": sdo.data.hex()}
