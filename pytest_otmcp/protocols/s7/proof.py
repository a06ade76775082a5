"""The proof that a session talks to the mock S7 controller: random bytes come back."""

from __future__ import annotations

from ..point import restoring
from ..proof import REACHED, Call, Proof
from .points import BLOCK, of_bytes, value_at

__all__ = ["PROOF"]

_BYTES, _DOUBLE, _WORD = of_bytes(40, 4), value_at(40, "DINT"), value_at(40)

PROOF = Proof(
    ways=(
        _BYTES.way(lambda rng: list(rng.randbytes(4)), bits=32),
        _DOUBLE.way(_DOUBLE.kind.any, bits=32),
        _WORD.way(_WORD.kind.any, bits=16),
        REACHED,
    ),
    restore=restoring(_DOUBLE),
    unreachable=(
        Call("read_db", {"db": BLOCK, "start": 0, "size": 8}),
        Call("read_typed", {"db": BLOCK, "start": 0, "type": "INT"}),
        Call("read_cpu_state"),
        Call("ping"),
    ),
)
