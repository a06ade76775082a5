"""What can be changed at the segment past the protocol.

Each poke names a ``slave`` by its position, from 0, and one of these members.

===========  ==============================================================================================================
``inputs``   ``{"slave": 0, "inputs": "02d5"}`` sets all of its input bytes, as hexadecimal digits
``object``   ``{"slave": 1, "object": [8193, 3], "data": "0700"}`` sets the bytes of an object, index and subindex
``refuses``  ``{"slave": 1, "refuses": 29}``: it refuses OP with this AL status code from now on; null: it does not
``falls``    ``{"slave": 1, "falls": 27}``: it leaves OP with this AL status code, its outputs are cleared
``present``  ``{"slave": 1, "present": false}``: it is taken off the line
===========  ==============================================================================================================
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from ..fault_rules import FLAG, integer
from .plant import Plant

__all__ = ["poke"]

_HEX = re.compile("(?:[0-9a-f]{2})*")
_CODE = integer(1, 0xFFFF)
_MEMBERS = ("inputs", "object", "refuses", "falls", "present")


def poke(plant: Plant, params: Mapping[str, Any]) -> None:
    """Change one slave.

    Raises:
        ValueError: no such slave, object or value.
        KeyError: a parameter is missing.
    """
    number = params["slave"]
    if type(number) is not int or not 0 <= number < len(plant.slaves):
        raise ValueError(f"there is no slave {number!r}; there are 0 to {len(plant.slaves) - 1}")
    slave = plant.slaves[number]
    found = [name for name in _MEMBERS if name in params]
    if len(found) != 1 or len(params) != 2 + (found == ["object"]):
        raise ValueError(f"a poke has 'slave' and one of {', '.join(_MEMBERS)}, found {sorted(params)}")
    (name,) = found
    value = params[name]
    if name == "inputs":
        content = _bytes(name, value)
        if len(content) != slave.input_bytes:
            raise ValueError(f"inputs: expected {slave.input_bytes} bytes, found {len(content)}")
        slave.inputs = content
    elif name == "object":
        held = slave.objects.get(tuple(value) if isinstance(value, list) else (0, 0))
        content = _bytes("data", params["data"])
        if held is None or (held.form and len(content) != len(held.data)):
            raise ValueError(f"slave {number} has no object {value!r} of {len(content)} bytes")
        held.data = content
    elif name == "present":
        if not FLAG.accepts(value):
            raise ValueError(f"present: expected {FLAG.expected}, found {value!r}")
        slave.present = value
    elif value is None and name == "refuses":
        slave.refuses = None
    elif not _CODE.accepts(value):
        raise ValueError(f"{name}: expected {_CODE.expected}, found {value!r}")
    elif name == "refuses":
        slave.refuses = value
    else:
        slave.fall(value)


def _bytes(name: str, value: Any) -> bytes:
    if not isinstance(value, str) or not _HEX.fullmatch(value):
        raise ValueError(f"{name}: expected bytes as hexadecimal digits, found {value!r}")
    return bytes.fromhex(value)
