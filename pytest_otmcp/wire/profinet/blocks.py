"""The blocks of acyclic services: a relation between a controller and a device is made, records are read and written, and it is given up
(IEC 61158-6-10, 4.12 and 5.2). All are big-endian."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ..framing import MalformedError
from .rt import GOOD

__all__ = [
    "ALARM_CR",
    "APPLICATION_READY",
    "CONTROLLER",
    "INPUTS",
    "INPUT_DATA",
    "IOCR",
    "MODULE_DIFFERENCE",
    "OUTPUTS",
    "OUTPUT_DATA",
    "PARAMETERS_END",
    "RELATION",
    "RELEASED",
    "SUBMODULES",
    "SUPERVISOR",
    "Block",
    "Control",
    "CyclicData",
    "Module",
    "Place",
    "Record",
    "Relation",
    "Submodule",
    "alarms_accepted",
    "blocks_of",
    "frame_ids",
    "input_data",
    "module_difference",
    "output_data",
]

RELATION, IOCR, ALARM_CR, SUBMODULES = 0x0101, 0x0102, 0x0103, 0x0104
WRITE_HEADER, READ_HEADER = 0x0008, 0x0009
PARAMETERS_END, APPLICATION_READY, RELEASED = 0x0110, 0x0112, 0x0114
ANSWER = 0x8000
"""What is added to the type of a block in an answer."""
MODULE_DIFFERENCE = 0x8104
INPUT_DATA, OUTPUT_DATA, SUBSTITUTE = 0x0015, 0x0016, 0x0014
"""Types of the blocks that the records 8028 and 8029 are."""
CONTROLLER, SUPERVISOR = 0x0001, 0x0006
"""Types of relations: one with cyclic data, and one of a supervisor for records alone."""
INPUTS, OUTPUTS = 1, 2
"""Types of cyclic data, as the controller sees them."""

_TYPE = struct.Struct(">HHBB")
_RELATION = struct.Struct(">H16sH6s16sIHHH")
_RELATION_ANSWER = struct.Struct(">H16sH6sH")
_CYCLIC = struct.Struct(">HHHIHHHHHHIHHH6sH")
_CYCLIC_ANSWER = struct.Struct(">HHH")
_ALARM_ANSWER = struct.Struct(">HHH")
_RECORD = struct.Struct(">H16sIHHHHI")
_RECORD_SIZE = 58
_CONTROL = struct.Struct(">H16sHHHH")
_PLACE = struct.Struct(">HHH")
_MODULE = struct.Struct(">IHIHH")
_SUBMODULE = struct.Struct(">HIH")
_DESCRIPTION = struct.Struct(">HHBB")

Place = tuple[int, int]
"""Slot and subslot."""


@dataclass(frozen=True, slots=True)
class Block:
    """A block: its type, and what follows its version, which is 1.0."""

    type: int
    body: bytes

    def encoded(self) -> bytes:
        """Return the block."""
        return _TYPE.pack(self.type, len(self.body) + 2, 1, 0) + self.body


def blocks_of(data: bytes) -> tuple[list[Block], bytes]:
    """Return the blocks of arguments or results, and what follows the header of a record: its content.

    Raises:
        MalformedError: a block goes beyond the end.
    """
    found: list[Block] = []
    at = 0
    while at < len(data):
        if len(data) < at + _TYPE.size:
            raise MalformedError("a block that is shorter than its header")
        kind, length, _, _ = _TYPE.unpack_from(data, at)
        end = at + 4 + length
        if length < 2 or end > len(data):
            raise MalformedError(f"a block {kind:04X} of {length} bytes that goes beyond the end")
        found.append(Block(kind, data[at + _TYPE.size : end]))
        at = end
        if kind & ~ANSWER in (WRITE_HEADER, READ_HEADER):
            break
    return found, data[at:]


def _fields(form: struct.Struct, body: bytes, at: int = 0) -> tuple[Any, ...]:
    try:
        return form.unpack_from(body, at)
    except struct.error:
        raise MalformedError("a block that is shorter than its fields") from None


@dataclass(frozen=True, slots=True, kw_only=True)
class Relation:
    """What a controller asks for first (ARBlockReq).

    Attributes:
        type: see :data:`SUPERVISOR`.
        identifier: 16 bytes of the controller's choice.
        key: number of the session.
        mac: of the controller.
        controller: identifier of the controller as an object.
        properties: flags.
        timeout: in steps of 100 ms, after which a relation without cyclic data ends when nothing is asked.
        name: of the controller.
    """

    type: int
    identifier: bytes
    key: int = 1
    mac: bytes = bytes(6)
    controller: bytes = bytes(16)
    properties: int = 0x11
    timeout: int = 100
    name: bytes = b"controller"

    @classmethod
    def parse(cls, body: bytes) -> Relation:
        """Read the block.

        Raises:
            MalformedError: it is too short.
        """
        kind, identifier, key, mac, controller, properties, timeout, _, length = _fields(_RELATION, body)
        name = body[_RELATION.size : _RELATION.size + length]
        return cls(
            type=kind,
            identifier=identifier,
            key=key,
            mac=mac,
            controller=controller,
            properties=properties,
            timeout=timeout,
            name=name,
        )

    def encoded(self) -> bytes:
        """Return the block."""
        head = (self.type, self.identifier, self.key, self.mac, self.controller, self.properties, self.timeout)
        return Block(RELATION, _RELATION.pack(*head, 0x8892, len(self.name)) + self.name).encoded()

    def accepted(self, mac: bytes) -> bytes:
        """Return the answer of a device with this address."""
        body = _RELATION_ANSWER.pack(self.type, self.identifier, self.key, mac, 0x8892)
        return Block(RELATION | ANSWER, body).encoded()


@dataclass(frozen=True, slots=True, kw_only=True)
class CyclicData:
    """The cyclic data of one direction (IOCRBlockReq).

    Attributes:
        type: :data:`INPUTS` or :data:`OUTPUTS`.
        reference: number of it.
        frame_id: of its frames; the device chooses that of outputs.
        length: bytes of a frame's data.
        clock, ratio: a frame is sent each ``clock * ratio`` steps of 31.25 µs.
        watchdog: so many frames may be missing.
        data: where each subslot's data begin in a frame; its provider status follows them.
        consumed: where the consumer status of each subslot is.
    """

    type: int
    reference: int
    frame_id: int
    length: int
    clock: int = 32
    ratio: int = 32
    watchdog: int = 3
    data: Mapping[Place, int] = field(default_factory=dict)
    consumed: Mapping[Place, int] = field(default_factory=dict)

    @property
    def cycle_s(self) -> float:
        """Seconds between two frames."""
        return self.clock * self.ratio / 32_000

    @classmethod
    def parse(cls, body: bytes) -> CyclicData:
        """Read the block.

        Raises:
            MalformedError: it is too short, or a place lies outside of the frame.
        """
        head = _fields(_CYCLIC, body)
        kind, reference, _, _, length, frame_id, clock, ratio, _, _, _, watchdog, _, _, _, interfaces = head
        places: tuple[dict[Place, int], dict[Place, int]] = {}, {}
        at = _CYCLIC.size
        for _ in range(interfaces):
            at += 4
            for part in places:
                (count,) = _fields(struct.Struct(">H"), body, at)
                at += 2
                for _ in range(count):
                    slot, subslot, offset = _fields(_PLACE, body, at)
                    if offset >= length:
                        raise MalformedError("a place in a cyclic frame that lies behind its end")
                    part[slot, subslot] = offset
                    at += _PLACE.size
        return cls(
            type=kind,
            reference=reference,
            frame_id=frame_id,
            length=length,
            clock=clock,
            ratio=ratio,
            watchdog=watchdog,
            data=places[0],
            consumed=places[1],
        )

    def encoded(self) -> bytes:
        """Return the block."""
        head = (self.type, self.reference, 0x8892, 1, self.length, self.frame_id, self.clock, self.ratio, 1, 0)
        body = _CYCLIC.pack(*head, 0xFFFFFFFF, self.watchdog, self.watchdog, 0xC000, bytes(6), 1) + bytes(4)
        for part in (self.data, self.consumed):
            body += len(part).to_bytes(2) + b"".join(_PLACE.pack(*place, offset) for place, offset in part.items())
        return Block(IOCR, body).encoded()

    def accepted(self, frame_id: int) -> tuple[CyclicData, bytes]:
        """Return what was agreed, and the answer of the device, which says the frame identifier."""
        agreed = replace(self, frame_id=frame_id)
        return agreed, Block(IOCR | ANSWER, _CYCLIC_ANSWER.pack(self.type, self.reference, frame_id)).encoded()


def frame_ids(data: bytes) -> dict[int, int]:
    """Return the frame identifiers in the answer to a Connect, by direction.

    Raises:
        MalformedError: a block goes beyond the end.
    """
    answers = (_fields(_CYCLIC_ANSWER, one.body) for one in blocks_of(data)[0] if one.type == IOCR | ANSWER)
    return {kind: frame_id for kind, _, frame_id in answers}


def alarms_accepted() -> bytes:
    """Return the answer to the part of a relation that is about alarms."""
    return Block(ALARM_CR | ANSWER, _ALARM_ANSWER.pack(1, 1, 200)).encoded()


@dataclass(frozen=True, slots=True, kw_only=True)
class Submodule:
    """What is in a subslot: its identifier, and the bytes of its inputs and outputs."""

    identifier: int
    inputs: int = 0
    outputs: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Module:
    """What a controller expects in a slot (a part of ExpectedSubmoduleBlockReq)."""

    slot: int
    identifier: int
    submodules: Mapping[int, Submodule]

    @classmethod
    def parse_all(cls, body: bytes) -> list[Module]:
        """Read the modules of a block.

        Raises:
            MalformedError: it is too short.
        """
        (count,) = _fields(struct.Struct(">H"), body)
        found, at = [], 2
        for _ in range(count):
            _, slot, identifier, _, submodules = _fields(_MODULE, body, at)
            at += _MODULE.size
            held: dict[int, Submodule] = {}
            for _ in range(submodules):
                subslot, own, properties = _fields(_SUBMODULE, body, at)
                at += _SUBMODULE.size
                lengths = [0, 0, 0]
                for _ in range(2 if properties & 3 == 3 else 1):
                    direction, length, _, _ = _fields(_DESCRIPTION, body, at)
                    at += _DESCRIPTION.size
                    lengths[direction & 3 if direction & 3 < 3 else 0] = length
                held[subslot] = Submodule(identifier=own, inputs=lengths[INPUTS], outputs=lengths[OUTPUTS])
            found.append(cls(slot=slot, identifier=identifier, submodules=held))
        return found

    def encoded(self) -> bytes:
        """Return a block with this module alone."""
        body = (1).to_bytes(2) + _MODULE.pack(0, self.slot, self.identifier, 0, len(self.submodules))
        for subslot, one in self.submodules.items():
            body += _SUBMODULE.pack(
                subslot, one.identifier, (INPUTS if one.inputs else 0) | (OUTPUTS if one.outputs else 0)
            )
            if one.inputs or not one.outputs:
                body += _DESCRIPTION.pack(INPUTS, one.inputs, 1, 1)
            if one.outputs:
                body += _DESCRIPTION.pack(OUTPUTS, one.outputs, 1, 1)
        return Block(SUBMODULES, body).encoded()


def module_difference(slots: Mapping[int, int | None]) -> bytes:
    """Return what a device adds to its answer when other modules are in these slots: their identifiers, None for no module."""
    body = struct.pack(">HIH", 1, 0, len(slots))
    for slot, identifier in slots.items():
        body += struct.pack(">HIHH", slot, identifier or 0, 0 if identifier is None else 1, 0)
    return Block(MODULE_DIFFERENCE, body).encoded()


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """Which record is read or written (IODReadReqHeader, IODWriteReqHeader).

    Attributes:
        writes: it is written.
        relation: identifier of the relation; zeros for a read without one.
        slot, subslot, index: where it is.
        length: bytes that are written, or that may be read.
        sequence: number of the access within the relation.
    """

    writes: bool
    relation: bytes
    slot: int
    subslot: int
    index: int
    length: int
    sequence: int = 0

    @classmethod
    def parse(cls, block: Block) -> Record:
        """Read the header of a request, or of an answer.

        Raises:
            MalformedError: it is too short, or another block.
        """
        kind = block.type & ~ANSWER
        if kind not in (WRITE_HEADER, READ_HEADER):
            raise MalformedError(f"a block {block.type:04X} in the place of a record's header")
        sequence, relation, _, slot, subslot, _, index, length = _fields(_RECORD, block.body)
        return cls(
            writes=kind == WRITE_HEADER,
            relation=relation,
            slot=slot,
            subslot=subslot,
            index=index,
            length=length,
            sequence=sequence,
        )

    def encoded(self, *, answer: bool = False, status: int = 0) -> bytes:
        """Return the header.

        Args:
            answer: it is that of an answer.
            status: PNIO status, which the answer to a write repeats.
        """
        kind = (WRITE_HEADER if self.writes else READ_HEADER) | (ANSWER if answer else 0)
        place = (self.sequence, self.relation, 0, self.slot, self.subslot, 0, self.index, self.length)
        more = struct.pack(">HHI", 0, 0, status) if answer and self.writes else b""
        return Block(kind, (_RECORD.pack(*place) + more).ljust(_RECORD_SIZE, b"\0")).encoded()


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """A step in the life of a relation: the end of parameters, readiness, release.

    Attributes:
        type: of the block, see :data:`RELEASED`.
        relation, key: of the relation.
        command: flags.
    """

    type: int
    relation: bytes
    key: int
    command: int

    @classmethod
    def parse(cls, block: Block) -> Control:
        """Read the block.

        Raises:
            MalformedError: it is too short.
        """
        _, relation, key, _, command, _ = _fields(_CONTROL, block.body)
        return cls(type=block.type, relation=relation, key=key, command=command)

    def encoded(self) -> bytes:
        """Return the block."""
        return Block(self.type, _CONTROL.pack(0, self.relation, self.key, 0, self.command, 0)).encoded()

    def done(self) -> bytes:
        """Return the answer: done."""
        return replace(self, type=self.type | ANSWER, command=_DONE).encoded()


_DONE = 8


def input_data(content: bytes, *, good: bool = True) -> bytes:
    """Return the record 8028 of a subslot: its inputs with their status."""
    return Block(INPUT_DATA, bytes([1, GOOD, 1, GOOD if good else 0]) + len(content).to_bytes(2) + content).encoded()


def output_data(content: bytes, *, active: bool) -> bytes:
    """Return the record 8029 of a subslot: its outputs with their status, and whether a controller sets them; else zeros take their place."""
    status = bytes([GOOD if active else 0])
    substitute = Block(SUBSTITUTE, struct.pack(">H", 0) + status + bytes(len(content))).encoded()
    head = struct.pack(">HBBH", not active, 1, 1, len(content))
    return Block(OUTPUT_DATA, head + status + content + status).encoded() + substitute
