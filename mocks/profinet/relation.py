"""The relations between the device and its controllers: supervisors, which access records, and one controller with cyclic data.

A relation with cyclic data ends with its release, when the same controller connects again, or at its watchdog: outputs are zero then.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pytest_otmcp.wire.profinet.blocks import (
    ALARM_CR,
    CONTROLLER,
    INPUTS,
    OUTPUTS,
    RELATION,
    SUBMODULES,
    SUPERVISOR,
    CyclicData,
    Module,
    Place,
    Relation,
    Submodule,
    alarms_accepted,
    blocks_of,
    module_difference,
)
from pytest_otmcp.wire.profinet.rpc import Rpc
from pytest_otmcp.wire.profinet.rt import GOOD, RtFrame
from pytest_otmcp.wire.profinet.services import agreed_of, subslots_of

from .plant import Plant

__all__ = ["Cyclic", "Denied", "Relations"]

FASTEST_S = 0.032
_FRAME_ID = 0xC101
"""Identifier of the frames with outputs."""
_PATIENCE_S = 5.0
"""Seconds in which the first outputs have to come."""
_NO_RELATION_BLOCK, _CYCLE_TOO_SHORT, _NO_CYCLIC_DATA, _NO_RESOURCES = 0x810100, 0x810209, 0x814002, 0x814004
_MOST = 16


class Denied(Exception):
    """A request to connect is refused.

    Attributes:
        code: the last three bytes of its PNIO status.
    """

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass(slots=True, kw_only=True)
class Cyclic:
    """The relation with cyclic data.

    Attributes:
        relation: what the controller asked for.
        agreed: its cyclic data by direction.
        expected: what it expects in each subslot; those that hold something else are left out.
        number, mac: of the client.
        sent: data of the last frame with outputs.
        running: inputs are sent.
    """

    relation: Relation
    agreed: Mapping[int, CyclicData]
    expected: Mapping[Place, Submodule]
    number: int
    mac: bytes
    sent: Mapping[Place, bytes] | None = None
    counter: int = 0
    running: bool = False
    timers: list[asyncio.TimerHandle] = field(default_factory=list)

    @property
    def watchdog_s(self) -> float:
        """Seconds without outputs after which the relation ends."""
        outputs = self.agreed[OUTPUTS]
        return outputs.watchdog * outputs.cycle_s

    def outputs(self, frame: RtFrame) -> dict[Place, bytes]:
        """Return what a frame sets."""
        return subslots_of(frame, self.agreed[OUTPUTS], self.expected)

    def inputs(self, plant: Plant) -> RtFrame:
        """Return the next frame with inputs."""
        agreed = self.agreed[INPUTS]
        data = bytearray(agreed.length)
        for place, begin in agreed.data.items():
            one = plant.subslots.get(place)
            content = bytes(one.inputs) if one is not None and place in self.expected else b""
            data[begin : begin + len(content) + 1] = content + bytes([GOOD if place in self.expected else 0])
        for place, where in agreed.consumed.items():
            data[where] = GOOD if place in self.expected else 0
        self.counter += agreed.clock * agreed.ratio
        return RtFrame(frame_id=agreed.frame_id, data=bytes(data[: agreed.length]), counter=self.counter)


class Relations:
    """All relations of the device.

    Args:
        plant: returns the plant.
        expired: is called when outputs have fallen because their controller is silent, with what they were.
    """

    def __init__(self, plant: Callable[[], Plant], expired: Callable[[Cyclic], None]) -> None:
        self._plant = plant
        self._expired = expired
        self.known: dict[bytes, Relation] = {}
        self.cyclic: Cyclic | None = None

    def connect(self, call: Rpc, number: int, controller: bytes, own: bytes) -> bytes:
        """Make a relation, and return the blocks of the answer.

        Args:
            number: of the client.
            controller, own: hardware addresses.

        Raises:
            Denied: it is not possible.
            MalformedError: its blocks cannot be read.
        """
        blocks, _ = blocks_of(call.blocks)
        if not blocks or blocks[0].type != RELATION:
            raise Denied(_NO_RELATION_BLOCK)
        relation = Relation.parse(blocks[0].body)
        if relation.type not in (CONTROLLER, SUPERVISOR):
            raise Denied(_NO_RELATION_BLOCK)
        answer = relation.accepted(own)
        if relation.type == CONTROLLER:
            answer += self._drive(call, relation, number, controller)
        if any(one.type == ALARM_CR for one in blocks):
            answer += alarms_accepted()
        if len(self.known) == _MOST:
            driving = self.cyclic and self.cyclic.relation.identifier
            del self.known[next(one for one in self.known if one != driving)]
        self.known[relation.identifier] = relation
        return answer

    def _drive(self, call: Rpc, relation: Relation, number: int, controller: bytes) -> bytes:
        agreed, expected = agreed_of(call)
        if {INPUTS, OUTPUTS} - agreed.keys():
            raise Denied(_NO_CYCLIC_DATA)
        if min(one.cycle_s for one in agreed.values()) < FASTEST_S:
            raise Denied(_CYCLE_TOO_SHORT)
        if self.cyclic is not None and self.cyclic.mac == controller:
            self.end()
        plant = self._plant()
        if plant.controller:
            raise Denied(_NO_RESOURCES)
        held = {place: one.module for place, one in plant.subslots.items()}
        modules = [
            module
            for one in blocks_of(call.blocks)[0]
            if one.type == SUBMODULES
            for module in Module.parse_all(one.body)
        ]
        asked = {(module.slot, subslot): module.identifier for module in modules for subslot in module.submodules}
        other = {place[0]: held.get(place) for place, one in asked.items() if held.get(place) != one}
        answer = b""
        chosen: dict[int, CyclicData] = {}
        for one in agreed.values():
            chosen[one.type], block = one.accepted(_FRAME_ID if one.type == OUTPUTS else one.frame_id)
            answer += block
        right = {
            place: one for place, one in expected.items() if place[0] not in other and one == plant.subslots[place].io
        }
        self.cyclic = Cyclic(relation=relation, agreed=chosen, expected=right, number=number, mac=controller)
        plant.controller = controller.hex(":")
        self.feed(_PATIENCE_S)
        return answer + (module_difference(other) if other else b"")

    def feed(self, seconds: float) -> None:
        """Let the outputs stand for so many seconds."""
        assert self.cyclic is not None
        for timer in self.cyclic.timers:
            timer.cancel()
        self.cyclic.timers = [asyncio.get_running_loop().call_later(seconds, self._silent, self.cyclic)]

    def _silent(self, cyclic: Cyclic) -> None:
        self._expired(cyclic)
        self.end()

    def release(self, identifier: bytes) -> bool:
        """Give a relation up; tell whether there was one."""
        if self.cyclic is not None and self.cyclic.relation.identifier == identifier:
            self.end()
        return self.known.pop(identifier, None) is not None

    def end(self) -> None:
        """End the relation with cyclic data."""
        if self.cyclic is not None:
            for timer in self.cyclic.timers:
                timer.cancel()
            self.known.pop(self.cyclic.relation.identifier, None)
            self.cyclic = None
            self._plant().let_go()
