"""The proof that a session talks to the mock Logix controller: random bytes come back."""

from __future__ import annotations

from ..point import restoring
from ..proof import REACHED, Call, Proof
from .points import ELEMENT, KINDS, LEVEL, TARGET, array

__all__ = ["PROOF"]

_ARRAY = array(0, 4)

PROOF = Proof(
    ways=(
        TARGET.way(TARGET.kind.any, bits=32),
        _ARRAY.way(lambda rng: [KINDS[ELEMENT].any(rng) for _ in range(4)], bits=64),
        REACHED,
    ),
    restore=restoring(TARGET, _ARRAY),
    unreachable=(
        *(Call(asked.operation, asked.inputs) for asked in (TARGET.reads(), _ARRAY.reads())),
        Call("read_tags", {"tags": ["BatchTarget"]}),
        Call("read_alias", LEVEL.reads().inputs),
        Call("read_clock"),
        Call("ping"),
    ),
)
