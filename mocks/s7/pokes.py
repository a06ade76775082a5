"""What can be changed at the controller past the protocol.

============  ==========================================================================================================
``data``      ``{"area": "DB10", "byte": 0, "data": "0032"}`` sets bytes, as hexadecimal digits
``cpu``       ``{"cpu": "STOP"}`` or ``"RUN"``: somebody has turned the switch
``put_get``   ``{"put_get": false}``: reads and writes are refused with 8104, as a CPU 1200 or 1500 is delivered
``pdu_size``  ``{"pdu_size": 240}``: largest PDU that a new connection is agreed to
``restless``  ``{"restless": [{"area": "M", "byte": 3, "bits": 64}]}``: these bits turn just before each request is executed, so
              between any two requests. The list takes the place of the one before; the image counts the ``changes``
============  ==========================================================================================================
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..fault_rules import FLAG, integer, one_of
from .image import Plant

__all__ = ["Restless", "poke", "restless_bits"]

_HEX = re.compile("(?:[0-9a-f]{2})+")
_STATES = one_of("RUN", "STOP")
_PDU_SIZE = integer(240, 960)


@dataclass(slots=True, kw_only=True)
class Restless:
    """Bits of a byte that turn by themselves, and how often they have."""

    area: str
    byte: int
    bits: int
    changes: int = 0

    def move(self, plant: Plant) -> None:
        """Turn the bits once."""
        plant.areas[self.area][self.byte] ^= self.bits
        self.changes += 1


def poke(plant: Plant, params: Mapping[str, Any]) -> None:
    """Change bytes, or one setting.

    Raises:
        ValueError: no such byte or value.
        KeyError: a parameter is missing.
    """
    if "cpu" in params:
        plant.running = _value(_STATES, "cpu", params) == "RUN"
    elif "put_get" in params:
        plant.put_get = _value(FLAG, "put_get", params)
    elif "pdu_size" in params:
        plant.pdu_size = _value(_PDU_SIZE, "pdu_size", params)
    else:
        text = params["data"]
        if not isinstance(text, str) or not _HEX.fullmatch(text):
            raise ValueError(f"data: expected bytes as hexadecimal digits, found {text!r}")
        content = bytes.fromhex(text)
        area, first = _bytes(plant, params["area"], params["byte"], len(content))
        area[first : first + len(content)] = content


def restless_bits(plant: Plant, sources: Any) -> list[Restless]:
    """Return the bits that a poke wants to turn by themselves.

    Raises:
        ValueError: no such bits.
        KeyError: a member is missing.
    """
    if not isinstance(sources, list) or not all(isinstance(source, Mapping) for source in sources):
        raise ValueError(f"restless: expected a list of objects, found {sources!r}")
    found = []
    for source in sources:
        _bytes(plant, source["area"], source["byte"], 1)
        bits = _value(integer(1, 0xFF), "bits", source)
        found.append(Restless(area=source["area"], byte=source["byte"], bits=bits))
    return found


def _value(field: Any, name: str, params: Mapping[str, Any]) -> Any:
    if not field.accepts(params[name]):
        raise ValueError(f"{name}: expected {field.expected}, found {params[name]!r}")
    return params[name]


def _bytes(plant: Plant, name: Any, byte: Any, count: int) -> tuple[bytearray, int]:
    area = plant.areas.get(name) if isinstance(name, str) else None
    if area is None:
        raise ValueError(f"unknown area {name!r}; known are {', '.join(plant.areas)}")
    if type(byte) is not int or not 0 <= byte <= len(area) - count:
        raise ValueError(f"{name}: there are no {count} byte(s) from {byte!r}, it has 0..{len(area) - 1}")
    return area, byte
