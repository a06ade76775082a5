"""The stations of the cable, the modules of the device, and the dynamics of the plant behind it.

======  ==========================================  ==================================================================================
slot 0  the device itself                           I&M0 in the index AFF0
slot 1  8 bytes of inputs                           UINT32 pieces, REAL flow; records 1 (UINT16, up to 1000), 2 (4 bytes, is not
                                                    written), 3 (8 bytes), 4 (2 bytes) and 5 (4 bytes)
slot 2  8 bytes of outputs                          UINT16 pump in 0.1 %, 6 free bytes
slot 3  2 bytes of inputs                           UINT16 temperature in 0.1 °C; record 3 (2 bytes)
slot 4  2 bytes of outputs                          UINT16 heater in 0.1 %
======  ==========================================  ==================================================================================

All of these are in subslot 1. Numbers have the most significant byte first. The plant moves the inputs; outputs belong to the controller,
and are zero without one. It is deterministic: the same ticks and writes give the same values.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any

from pytest_otmcp.wire.profinet.blocks import Submodule

__all__ = ["DEVICE", "NEIGHBOUR", "VENDOR", "Plant", "Station", "Subslot"]

VENDOR, DEVICE = 0x0ABC, 0x0001
NEIGHBOUR = bytes.fromhex("026f746d6370")
"""Hardware address of the station that answers DCP alone."""
_AMBIENT, _START, _FULL = 20.0, 72.5, 1000


@dataclass(slots=True, kw_only=True)
class Station:
    """What DCP says of a station, and what it may change.

    Attributes:
        mac: its hardware address; empty for that of the interface.
        name: by which controllers know it.
        ip, mask, gateway: of its addresses as text.
        permanent: it keeps the name when it is switched off.
        present: it is there and answers.
    """

    mac: bytes
    name: str
    ip: str
    mask: str = "255.255.255.0"
    gateway: str = "0.0.0.0"  # noqa: S104  (no gateway)
    permanent: bool = True
    present: bool = True


@dataclass(slots=True, kw_only=True)
class Subslot:
    """One subslot 1: the identifiers of its module, what it measures and sets, and its records."""

    module: int
    io: Submodule
    inputs: bytearray = field(default_factory=bytearray)
    outputs: bytearray = field(default_factory=bytearray)
    records: dict[int, bytearray] = field(default_factory=dict)
    read_only: frozenset[int] = frozenset()
    limits: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.inputs = self.inputs or bytearray(self.io.inputs)
        self.outputs = self.outputs or bytearray(self.io.outputs)


class Plant:
    """The stations, the device's subslots by slot and subslot, and what they measure."""

    def __init__(self) -> None:
        self.device = Station(mac=b"", name="kit-device", ip="10.77.0.2")
        self.neighbour = Station(mac=NEIGHBOUR, name="kit-neighbour", ip="10.77.0.3")
        self.subslots = {
            (0, 1): Subslot(module=0x0000_0001, io=Submodule(identifier=1)),
            (1, 1): Subslot(
                module=0x0000_0010,
                io=Submodule(identifier=1, inputs=8),
                records={1: bytearray(b"\0\x64"), 2: bytearray(4), 3: bytearray(8), 4: bytearray(2), 5: bytearray(4)},
                read_only=frozenset({2}),
                limits={1: 1000},
            ),
            (2, 1): Subslot(module=0x0000_0020, io=Submodule(identifier=1, outputs=8)),
            (3, 1): Subslot(module=0x0000_0011, io=Submodule(identifier=1, inputs=2), records={3: bytearray(2)}),
            (4, 1): Subslot(module=0x0000_0021, io=Submodule(identifier=1, outputs=2)),
        }
        self.controller = ""
        """Address of the controller that has a relation with cyclic data; ``other`` where it is not on this cable."""
        self.signalled = 0
        """How often somebody has asked the device to show itself (DCP Signal)."""
        self._temperature, self._pieces = _START, 0
        self._publish()

    @property
    def stations(self) -> tuple[Station, ...]:
        """Both stations."""
        return self.device, self.neighbour

    def image(self) -> dict[str, Any]:
        """Return ``stations``, what DCP says of each; ``modules``, their identifiers by slot; ``controller`` and ``signalled``; and
        ``points``: ``name``, ``ip``, ``1.1.input.0``, ``2.1.output.7``, ``1.1.record.3.0``, …, a byte each."""
        points: dict[str, Any] = {"name": self.device.name, "ip": self.device.ip}
        for (slot, number), one in self.subslots.items():
            held = {"input": one.inputs, "output": one.outputs}
            held |= {f"record.{index}": content for index, content in one.records.items()}
            for name, content in held.items():
                points |= {f"{slot}.{number}.{name}.{place}": value for place, value in enumerate(content)}
        stations = {
            one.name: {
                "mac": one.mac.hex(":"),
                "ip": one.ip,
                "mask": one.mask,
                "permanent": one.permanent,
                "present": one.present,
            }
            for one in self.stations
        }
        modules = {str(slot): f"{one.module:08x}" for (slot, _), one in self.subslots.items()}
        told = {"controller": self.controller, "signalled": self.signalled}
        return {"stations": stations, "modules": modules, **told, "points": points}

    def controlled_as(self, other: Plant) -> None:
        """Take over the controller and the outputs of another plant."""
        self.controller = other.controller
        for place, one in self.subslots.items():
            one.outputs[:] = other.subslots[place].outputs

    def let_go(self) -> None:
        """Clear the outputs: no controller sets them any more."""
        self.controller = ""
        for one in self.subslots.values():
            one.outputs[:] = bytes(len(one.outputs))

    def tick(self) -> None:
        """Advance by one second: temperature follows the heater, pieces and flow the pump."""
        self._temperature += (_AMBIENT + self._order(4) * 200 - self._temperature) * 0.05
        self._pieces = (self._pieces + 1 + round(self._order(2) * 10)) & 0xFFFFFFFF
        self._publish()

    def _order(self, slot: int) -> float:
        return min(int.from_bytes(self.subslots[slot, 1].outputs[:2]), _FULL) / _FULL

    def _publish(self) -> None:
        struct.pack_into(">If", self.subslots[1, 1].inputs, 0, self._pieces, self._order(2) * 120)
        struct.pack_into(">H", self.subslots[3, 1].inputs, 0, round(self._temperature * 10))
