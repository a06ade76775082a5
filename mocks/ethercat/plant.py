"""The slaves of the segment and the dynamics of the plant behind them.

=======  ===================  ==========================================================================================
slave 0  terminal             2 bytes of inputs: UINT16 temperature in 0.1 °C; 2 of outputs: UINT16 heater in 0.1 %
slave 1  drive                8 bytes of inputs: UINT32 pieces, REAL32 flow; 8 of outputs: INT16 speed in 0.1 %, 2 free
                              bytes, REAL32 limit; objects 2000 (acceleration, 0 to 1000), 2001 (one of each type), 2002
=======  ===================  ==========================================================================================

Positions count from 0. The plant moves the inputs; objects and outputs belong to the clients. It is deterministic: the same ticks and writes
give the same values.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial
from typing import Any

from .objects import Dictionary, common, entry
from .slave import Slave

__all__ = ["DRIVE", "TERMINAL", "Plant"]

TERMINAL, DRIVE = 0, 1
_VENDOR = 0x0ABC
_FORMS = ("b", "B", "h", "H", "i", "I", "q", "Q", "f", "d", "?")
_AMBIENT, _START = 20.0, 72.5


def _objects(number: int) -> Dictionary:
    if number == TERMINAL:
        return common("OTMCP-TERMINAL", 0x00001389, (_VENDOR, 0x11, 1, 1001), 2, 2)
    found = common("OTMCP-DRIVE", 0x00020192, (_VENDOR, 0x12, 1, 1002), 8, 8)
    found |= {
        (0x2000, 0): entry("B", 1),
        (0x2000, 1): entry("H", 100, "rw", lowest=0, highest=1000),
        (0x2001, 0): entry("B", len(_FORMS)),
        **{(0x2001, sub): entry(form, 0, "rw") for sub, form in enumerate(_FORMS, start=1)},
        (0x2002, 0): entry("", "spare", "rw"),
        (0x2003, 0): entry("I", 0, "wo"),
    }
    return found


class Plant:
    """The slaves in their order on the line, and what they measure.

    Args:
        posted: is called with the number of a slave whose mailbox the master has filled, and its content.
    """

    def __init__(self, posted: Callable[[int, bytes], None]) -> None:
        self.slaves = [
            Slave(_objects(number), size, size, partial(posted, number), last=number == DRIVE)
            for number, size in ((TERMINAL, 2), (DRIVE, 8))
        ]
        self._temperature, self._pieces = _START, 0
        self._publish()

    def image(self) -> dict[str, Any]:
        """Return ``slaves``, the state of each, and ``points``: ``1:2001:3`` for an object, ``0.input.0``, ``1.output.1``, … for a byte."""
        points: dict[str, Any] = {}
        for number, slave in enumerate(self.slaves):
            for (index, sub), found in slave.objects.items():
                if found.access != "ro":
                    points[f"{number}:{index:04x}:{sub}"] = found.value
            for name, held in (("input", slave.inputs), ("output", slave.outputs)):
                points |= {f"{number}.{name}.{at}": byte for at, byte in enumerate(held)}
        return {"slaves": [slave.image() for slave in self.slaves], "points": points}

    def tick(self) -> None:
        """Advance by one second: temperature follows the heater, pieces and flow the speed."""
        heater, speed = (self._order(number) for number in (TERMINAL, DRIVE))
        self._temperature += (_AMBIENT + max(heater, 0) * 200 - self._temperature) * 0.05
        self._pieces = (self._pieces + 1 + round(abs(speed) * 10)) & 0xFFFFFFFF
        self._publish()

    def _order(self, number: int) -> float:
        return max(-1.0, min(int.from_bytes(self.slaves[number].outputs[:2], "little", signed=True) / 1000, 1.0))

    def _publish(self) -> None:
        self.slaves[TERMINAL].inputs = struct.pack("<H", round(self._temperature * 10))
        self.slaves[DRIVE].inputs = struct.pack("<If", self._pieces, self._order(DRIVE) * 120)
