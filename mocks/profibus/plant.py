"""The slaves of the segment and the dynamics of the plant behind them.

=========  ====================  =====================================================================================
station 5  809C, 11 21           2 bytes of inputs: UINT16 temperature in 0.1 °C; 2 of outputs: UINT16 heater in 0.1 %
station 8  80A5, 17 27           8 bytes of inputs: UINT32 pieces, REAL flow; 8 of outputs: UINT16 pump in 0.1 %, 6 free bytes
station 9  80B1, 10 20           a byte of inputs and one of outputs; a master with the address 3 owns it
=========  ====================  =====================================================================================

Numbers have the most significant byte first. The plant moves the inputs, and the outputs of station 9; other outputs belong to the
clients. It is deterministic: the same ticks and writes give the same values.
"""

from __future__ import annotations

import struct
from typing import Any

from .slave import Slave

__all__ = ["OTHER_MASTER", "Plant"]

OTHER_MASTER = 3
_AMBIENT = 20.0
_START = 72.5
_FULL = 1000


class Plant:
    """The slaves by address, and what they measure."""

    def __init__(self) -> None:
        self.slaves = {
            5: Slave(ident=b"\x80\x9c", configuration=b"\x11\x21"),
            8: Slave(ident=b"\x80\xa5", configuration=b"\x17\x27"),
            9: Slave(ident=b"\x80\xb1", configuration=b"\x10\x20"),
        }
        self.slaves[9].belong_to(OTHER_MASTER)
        self._temperature = _START
        self._pieces = 0
        self._seconds = 0
        self._publish()

    def image(self) -> dict[str, Any]:
        """Return ``stations``, what each is and who owns it, and ``points``: ``5.input.0``, ``5.output.1``, …, a byte each."""
        points = {
            f"{address}.{name}.{index}": value
            for address, slave in self.slaves.items()
            for name, held in (("input", slave.inputs), ("output", slave.outputs))
            for index, value in enumerate(held)
        }
        return {"stations": {str(address): one.image() for address, one in self.slaves.items()}, "points": points}

    def tick(self) -> None:
        """Advance by one second: temperature follows the heater, pieces and flow the pump, station 9 its own master."""
        self._seconds += 1
        heater, pump = self._order(5), self._order(8)
        self._temperature += (_AMBIENT + heater * 200 - self._temperature) * 0.05
        self._pieces = (self._pieces + 1 + round(pump * 10)) & 0xFFFFFFFF
        self._publish()

    def _order(self, address: int) -> float:
        return min(int.from_bytes(self.slaves[address].outputs[:2]), _FULL) / _FULL

    def _publish(self) -> None:
        struct.pack_into(">H", self.slaves[5].inputs, 0, round(self._temperature * 10))
        struct.pack_into(">If", self.slaves[8].inputs, 0, self._pieces, self._order(8) * 120)
        turning = self.slaves[9]
        turning.outputs[0] = self._seconds & 1 if turning.owner == OTHER_MASTER else turning.outputs[0]
        turning.inputs[0] = self._seconds & 0xFF
