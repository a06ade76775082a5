"""The proof that a session talks to the mock BACnet device: random present values come back."""

from __future__ import annotations

import random
from typing import Any

from ..point import restoring
from ..proof import REACHED, Call, Proof
from .points import DEVICE, ZONE, alias, value_of

__all__ = ["PROOF"]

_ZONE, _ALIAS = value_of(ZONE), alias("otmcp_zone", ZONE)
_BITS, _ROUNDED_BITS = 24, 17
"""Random bits of a value of 24 bits, and of one that an adapter has rounded to hundredths."""


def _value(rng: random.Random) -> float:
    # A REAL holds 24 bits exactly.
    return rng.getrandbits(24) / 128


def _same(found: Any, value: float) -> int:
    if isinstance(found, bool) or not isinstance(found, int | float):
        return 0
    return _BITS if found == value else _ROUNDED_BITS if abs(found - value) <= 0.005 else 0


PROOF = Proof(
    ways=(*(point.way(_value, _BITS, same=_same) for point in (_ZONE, _ALIAS)), REACHED),
    restore=restoring(_ZONE),
    unreachable=(
        *(Call(asked.operation, asked.inputs) for asked in (_ZONE.reads(), _ALIAS.reads())),
        Call("list_objects", {"device": DEVICE}),
        Call("ping"),
    ),
)
