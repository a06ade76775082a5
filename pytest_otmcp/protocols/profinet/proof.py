"""The proof that a session talks to the mock PROFINET device: random inputs come back."""

from __future__ import annotations

from ..point import UINT64, restoring
from ..proof import REACHED, Call, Proof
from .points import DRIVE, STATION, VALVES, input_named, inputs_of

__all__ = ["PROOF"]

_WIDE, _NARROW, _COUNTER = inputs_of(DRIVE), inputs_of(VALVES), input_named("otmcp_counter", UINT64)

PROOF = Proof(
    ways=(
        _WIDE.way(lambda rng: list(rng.randbytes(8)), bits=64),
        _NARROW.way(lambda rng: list(rng.randbytes(2)), bits=16),
        # Below 2 to the 53 every JSON number is exact.
        _COUNTER.way(lambda rng: rng.getrandbits(53), bits=53),
        REACHED,
    ),
    restore=restoring(_WIDE, _NARROW),
    unreachable=(
        Call("read_inputs", {"station": STATION, "slot": VALVES, "subslot": 1}),
        Call("read_alias", {"name": "otmcp_counter"}),
        Call("ping"),
    ),
)
