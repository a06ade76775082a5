"""The proof that a session talks to the mock outstation: random values come back."""

from __future__ import annotations

import random

from ..point import restoring
from ..proof import REACHED, Call, Proof
from .points import OUTSTATION, analog, at, named, several

__all__ = ["PROOF"]

_LEVEL, _CONTACTS = analog(1), several("binary", 8, 8)
"""An analog input, and binary inputs that make no events."""


def _number(rng: random.Random) -> int:
    return rng.getrandbits(32) - 2**31


PROOF = Proof(
    ways=(
        _LEVEL.way(_number, bits=32),
        named("otmcp_level").way(_number, bits=32),
        _CONTACTS.way(lambda rng: [bool(rng.getrandbits(1)) for _ in range(8)], bits=8),
        REACHED,
    ),
    restore=restoring(_LEVEL, _CONTACTS),
    unreachable=(
        Call("read_analog", at(1)),
        Call("read_alias", {"name": "otmcp_level"}),
        Call("read_binary", at(8, 8)),
        Call("poll", {"outstation": OUTSTATION, "event_class": 0}),
        Call("ping"),
    ),
)
