"""What can be changed at the device past the protocol.

==============  ========================================================================================================
``inputs``      ``{"slot": 1, "inputs": "02d5…"}`` sets all input bytes of its subslot 1, as hexadecimal digits
``record``      ``{"slot": 1, "index": 3, "record": "…"}`` sets a record
``module``      ``{"slot": 2, "module": "00000099"}``: another module was put into the slot
``controller``  ``{"controller": true}``: another controller of the plant has the device from now on; false: none has
``name``        ``{"station": "kit-neighbour", "name": "kit-two"}``: a station has this name
``present``     ``{"station": "kit-neighbour", "present": false}``: it is taken off the cable
==============  ========================================================================================================
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from ..fault_rules import FLAG, TEXT
from .plant import Plant, Subslot

__all__ = ["poke"]

_HEX = re.compile("(?:[0-9a-f]{2})*")
_FORMS = (
    {"slot", "inputs"},
    {"slot", "index", "record"},
    {"slot", "module"},
    {"controller"},
    {"station", "name"},
    {"station", "present"},
)


def poke(plant: Plant, params: Mapping[str, Any]) -> None:
    """Change the device.

    Raises:
        ValueError: no such slot, station or value.
    """
    if params.keys() not in _FORMS:
        forms = "; ".join(", ".join(sorted(form)) for form in _FORMS)
        raise ValueError(f"a poke has the members of one of these: {forms}; found {sorted(params)}")
    if "slot" in params:
        _change(_subslot(plant, params["slot"]), params)
    elif "controller" in params:
        plant.let_go()
        plant.controller = "other" if _flag(params, "controller") else ""
    else:
        station = next((one for one in plant.stations if one.name == params["station"]), None)
        if station is None:
            raise ValueError(f"there is no station {params['station']!r}")
        if "present" in params:
            station.present = _flag(params, "present")
        elif TEXT.accepts(params["name"]):
            station.name = params["name"]
        else:
            raise ValueError(f"name: expected {TEXT.expected}, found {params['name']!r}")


def _subslot(plant: Plant, slot: Any) -> Subslot:
    found = plant.subslots.get((slot, 1)) if type(slot) is int else None
    if found is None:
        raise ValueError(f"there is no slot {slot!r}; there are {', '.join(str(slot) for slot, _ in plant.subslots)}")
    return found


def _change(one: Subslot, params: Mapping[str, Any]) -> None:
    if "module" in params:
        one.module = int.from_bytes(_bytes(params, "module", 4))
    elif "inputs" in params:
        one.inputs[:] = _bytes(params, "inputs", len(one.inputs))
    elif params["index"] not in one.records:
        raise ValueError(f"there is no record {params['index']!r}; there are {', '.join(map(str, one.records))}")
    else:
        held = one.records[params["index"]]
        held[:] = _bytes(params, "record", len(held))


def _bytes(params: Mapping[str, Any], name: str, length: int) -> bytes:
    value = params[name]
    if not isinstance(value, str) or not _HEX.fullmatch(value) or len(value) != 2 * length:
        raise ValueError(f"{name}: expected {length} byte(s) as hexadecimal digits, found {value!r}")
    return bytes.fromhex(value)


def _flag(params: Mapping[str, Any], name: str) -> bool:
    if not FLAG.accepts(params[name]):
        raise ValueError(f"{name}: expected {FLAG.expected}, found {params[name]!r}")
    return bool(params[name])
