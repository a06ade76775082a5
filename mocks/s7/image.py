"""The memory of the controller, its operating state, and the dynamics of the plant behind it.

======  =========================================================================================================
DB1     256 bytes, the plant's: 0 REAL motor speed, 4 REAL torque, 8 REAL flow, 12 DINT batch, 16 REAL temperature
DB2     64 bytes, the plant's: 0.0 alarm, 2 STRING[30] message
DB9     32 bytes, protected: neither read nor written
DB10    64 bytes, the clients': 0 INT valve, 2 INT heater, 4 INT fan, 6 INT conveyor (percent), 8 REAL rate, 12 DINT, 16 bits,
        20 STRING[30]
DB20    "optimized": there is no offset that could be addressed
I Q M   16 bytes each: I0.0 running, I0.1 hot, Q0.0 pump
======  =========================================================================================================

The plant moves DB1, DB2 and I, and only while the CPU is in RUN; every other byte belongs to the clients. It is deterministic: the
same ticks and writes give the same values.
"""

from __future__ import annotations

import math
import struct
from typing import Any

__all__ = ["OPTIMIZED", "PROTECTED", "Plant", "point"]

PROTECTED, OPTIMIZED = "DB9", "DB20"
_SIZES = {"DB1": 256, "DB2": 64, PROTECTED: 32, "DB10": 64, "I": 16, "Q": 16, "M": 16}
_AMBIENT = 20.0
_ALARM_LIMIT = 90.0


def point(area: str, byte: int) -> str:
    """Return the name of a byte as S7 writes it: ``DB10.DBB4``, ``MB3``."""
    return f"{area}.DBB{byte}" if area.startswith("DB") else f"{area}B{byte}"


class Plant:
    """The memory and the state of one controller.

    Attributes:
        areas: bytes by name of the area: ``DB10``, ``I``, ``Q``, ``M``. The optimized data block has no bytes here.
        running: the CPU is in RUN, else in STOP.
        put_get: clients may read and write; a CPU 1200 or 1500 is delivered without.
        pdu_size: largest PDU, in bytes, that the controller agrees to with a new client.
    """

    def __init__(self) -> None:
        self.areas = {name: bytearray(size) for name, size in _SIZES.items()}
        self.running = True
        self.put_get = True
        self.pdu_size = 480
        self._temperature = 25.0
        self._batch = 0.0
        self._seconds = 0
        block = self.areas["DB10"]
        struct.pack_into(">4hfi", block, 0, 50, 30, 40, 60, 100.0, 7)
        _set_string(block, 20, b"ready")
        _set_string(self.areas["DB2"], 2, b"no message")
        self.areas["Q"][0] = 1
        self._publish()

    def image(self) -> dict[str, Any]:
        """Return the areas as hexadecimal digits, the state, and ``points``: each byte, and ``CPU``."""
        points: dict[str, Any] = {
            point(name, byte): value for name, area in self.areas.items() for byte, value in enumerate(area)
        }
        state = "RUN" if self.running else "STOP"
        return {
            "areas": {name: area.hex() for name, area in self.areas.items()},
            "cpu": state,
            "put_get": self.put_get,
            "pdu_size": self.pdu_size,
            "points": {**points, "CPU": state},
        }

    def tick(self) -> None:
        """Advance by one second: temperature (heater, fan), batch (conveyor, rate), motor and flow (valve, pump)."""
        if not self.running:
            return
        self._seconds += 1
        _, heater, fan, conveyor, rate, _ = self._orders()
        self._temperature += (_AMBIENT + heater * 0.8 - fan * 0.1 - self._temperature) * 0.05
        self._batch += rate / 60 * conveyor / 100
        self._publish()

    def _orders(self) -> tuple[float, ...]:
        """Return what the clients have ordered; a percentage out of bounds, or no number, is brought within."""
        valve, heater, fan, conveyor, rate, target = struct.unpack_from(">4hfi", self.areas["DB10"])
        bounded = [min(max(percent, 0), 100) for percent in (valve, heater, fan, conveyor)]
        return (*bounded, min(max(rate, 0.0), 1e6) if math.isfinite(rate) else 0.0, target)

    def _publish(self) -> None:
        valve, _, _, conveyor, _, _ = self._orders()
        wave = math.sin(self._seconds / 10)
        pumping = self.areas["Q"][0] & 1
        hot = self._temperature > _ALARM_LIMIT
        motor, flow = conveyor * 15 + wave, (valve * 1.2 if pumping else 0.0)
        struct.pack_into(
            ">3fif", self.areas["DB1"], 0, motor, 12 + wave, flow, int(self._batch) & 0x7FFFFFFF, self._temperature
        )
        self.areas["DB2"][0] = self.areas["DB2"][0] & 0xFE | hot
        self.areas["I"][0] = self.areas["I"][0] & 0xFC | self.running | hot << 1


def _set_string(block: bytearray, offset: int, text: bytes, most: int = 30) -> None:
    block[offset : offset + 2 + len(text)] = bytes([most, len(text)]) + text
