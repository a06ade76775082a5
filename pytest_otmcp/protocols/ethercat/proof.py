"""The proof that a session talks to the mock EtherCAT segment: random objects and inputs come back."""

from __future__ import annotations

from ..point import restoring
from ..proof import REACHED, Call, Proof
from .points import DRIVE, TERMINAL, TYPED, inputs_of

__all__ = ["PROOF"]

_WIDE, _NARROW, _COUNTER = inputs_of(DRIVE), inputs_of(TERMINAL), TYPED["UINT32"]
_READ = _COUNTER.reads()

PROOF = Proof(
    ways=(
        _COUNTER.way(_COUNTER.kind.any, bits=32),
        _WIDE.way(lambda rng: list(rng.randbytes(8)), bits=64),
        _NARROW.way(lambda rng: list(rng.randbytes(2)), bits=16),
        REACHED,
    ),
    restore=restoring(_COUNTER, _WIDE, _NARROW),
    unreachable=(
        Call(_READ.operation, _READ.inputs),
        Call("read_inputs", {"slave": TERMINAL}),
        Call("read_state", {"slave": TERMINAL}),
        Call("ping"),
    ),
)
