"""What can be changed at the segment past the protocol.

Each poke names a ``station`` and one of these members.

=============  =========================================================================================================
``inputs``     ``{"station": 5, "inputs": "02d5"}`` sets all of its input bytes, as hexadecimal digits
``outputs``    the same for its outputs
``master``     ``{"station": 5, "master": 3}``: another master of the plant owns it from now on; null: nobody does
``present``    ``{"station": 5, "present": false}``: it is taken off the line
``ident``      ``{"station": 5, "ident": "1234"}``: there is another device at the address, which waits for parameters
``diagnosis``  bytes of an extended diagnosis, as hexadecimal digits; empty for none
=============  =========================================================================================================
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from ..fault_rules import FLAG, integer
from .plant import Plant
from .slave import Slave

__all__ = ["poke"]

_HEX = re.compile("(?:[0-9a-f]{2})*")
_MASTER = integer(0, 126)
_MEMBERS = ("inputs", "outputs", "master", "present", "ident", "diagnosis")
_LONGEST_DIAGNOSIS = 238
"""Bytes of an extended diagnosis at most: a diagnosis has 244."""


def poke(plant: Plant, params: Mapping[str, Any]) -> None:
    """Change one slave.

    Raises:
        ValueError: no such station or value.
        KeyError: a parameter is missing.
    """
    address = params["station"]
    if type(address) is not int or address not in plant.slaves:
        known = ", ".join(map(str, plant.slaves))
        raise ValueError(f"there is no station {address!r}; there are {known}")
    slave = plant.slaves[address]
    found = [name for name in _MEMBERS if name in params]
    if len(found) != 1 or len(params) != 2:
        raise ValueError(f"a poke has 'station' and one of {', '.join(_MEMBERS)}, found {sorted(params)}")
    (name,) = found
    _change(slave, name, params[name])


def _change(slave: Slave, name: str, value: Any) -> None:
    if name in ("inputs", "outputs"):
        held = slave.inputs if name == "inputs" else slave.outputs
        content = _bytes(name, value)
        if len(content) != len(held):
            raise ValueError(f"{name}: expected {len(held)} byte(s), found {len(content)}")
        held[:] = content
    elif name == "ident":
        content = _bytes(name, value)
        if len(content) != len(slave.ident):
            raise ValueError(f"ident: expected {len(slave.ident)} bytes, found {len(content)}")
        slave.leave()
        slave.ident = content
    elif name == "diagnosis":
        content = _bytes(name, value)
        if len(content) > _LONGEST_DIAGNOSIS:
            raise ValueError(f"diagnosis: expected at most {_LONGEST_DIAGNOSIS} bytes, found {len(content)}")
        slave.diagnose(content)
    elif name == "present":
        if not FLAG.accepts(value):
            raise ValueError(f"present: expected {FLAG.expected}, found {value!r}")
        slave.present = value
    elif value is None:
        slave.leave()
    elif _MASTER.accepts(value):
        slave.belong_to(value)
    else:
        raise ValueError(f"master: expected {_MASTER.expected} or null, found {value!r}")


def _bytes(name: str, value: Any) -> bytes:
    if not isinstance(value, str) or not _HEX.fullmatch(value):
        raise ValueError(f"{name}: expected bytes as hexadecimal digits, found {value!r}")
    return bytes.fromhex(value)
