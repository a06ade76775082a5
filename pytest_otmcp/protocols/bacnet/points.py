"""The points of the mock BACnet device: present values of its objects, as such and by the names of a list."""

from __future__ import annotations

import math
import random
from typing import Any

from ..point import FLOAT32, UINT8, Kind, Point
from ..proof import Call
from .entries import Target

__all__ = [
    "DEVICE",
    "LEVEL",
    "MODE",
    "PRIORITY",
    "SETPOINT",
    "SUPPLY",
    "VALVE",
    "ZONE",
    "alias",
    "positive_half",
    "present",
    "setting",
    "value_of",
]

DEVICE, PRIORITY = 12345, 8
ZONE, SUPPLY = ("analog-input", 1), ("analog-input", 2)
VALVE, SETPOINT = ("analog-output", 1), ("analog-value", 2)


def positive_half(rng: random.Random) -> float:
    """Return a half, which a REAL holds exactly."""
    return rng.randrange(2**20) + 0.5


def present(target: Target) -> str:
    """Return the point of an object's present value."""
    return f"{target[0]},{target[1]}/present-value"


def setting(target: Target, value: Any, priority: int | None = None) -> dict[str, object]:
    """Return the poke that sets a present value, or a slot of its priority array."""
    told = value if not isinstance(value, float) or math.isfinite(value) else str(value)
    slot = {} if priority is None else {"priority": priority}
    return {"object": f"{target[0]},{target[1]}", "value": told, **slot}


def value_of(
    target: Target, kind: Kind = FLOAT32, *, further: bool = False, slot: int | None = None, priority: int = PRIORITY
) -> Point:
    """Return the present value of an object.

    Args:
        further: the object is one of a datatype that few devices have.
        slot: of the priority array that is set at the mock.
        priority: of a write.
    """
    place = {"device": DEVICE, "type": target[0], "instance": target[1]}
    prepared = ({"types": True},) if further else ()
    return Point(
        kind=kind,
        reading=Call("read", place),
        writing=Call("write", {**place, "value": None, "priority": priority}),
        pokes=lambda value: (*prepared, setting(target, value, slot)),
        held=lambda value: {present(target): value},
        found=lambda image: image["points"].get(present(target)),
        condition={"object": f"{target[0]},{target[1]}"},
    )


def alias(name: str, target: Target) -> Point:
    """Return the present value that a launch of an adapter with names of its own knows by a name."""
    call = Call("read_alias", {"name": name})
    of_target = value_of(target)
    return Point(
        kind=FLOAT32,
        reading=call,
        writing=Call("write_alias", call.inputs),
        pokes=of_target.pokes,
        held=of_target.held,
        found=of_target.found,
    )


LEVEL = value_of(("analog-value", 9))
"""A number that the device limits to 0 to 10."""
MODE = value_of(("multi-state-value", 1), UINT8)
"""One of three states, from 1 on."""
