"""The proof that a session talks to the mock OPC UA server: random values of variables come back."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping

from ..journal import Entries, Image
from ..proof import Call, Proof, Question, Way, exchanged

__all__ = ["PROOF"]

_NAMES = ("Temperature", "Pressure")
_NODES = tuple(f"ns=2;s={name}" for name in _NAMES)


def _values(rng: random.Random) -> list[float]:
    return [round(rng.uniform(-50.0, 150.0), 6) for _ in _NAMES]


def _pokes(values: list[float]) -> tuple[Mapping[str, object], ...]:
    return tuple({"node": name, "value": value} for name, value in zip(_NAMES, values, strict=True))


def _bits(found: object, value: float) -> int:
    """Count the random bits of a value that was found, also of one that an adapter has rounded: it is one of 10 million, or of 5000."""
    if isinstance(found, bool) or not isinstance(found, int | float) or not math.isfinite(found):
        return 0
    return 23 if abs(found - value) < 1e-5 else 12 if abs(found - value) < 0.02 else 0


def _read_one(rng: random.Random) -> Question:
    values = _values(rng)

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        return _bits(outputs.get("value"), values[0])

    return Question(inputs={"node": _NODES[0]}, pokes=_pokes(values), bits=bits)


def _read_many(rng: random.Random) -> Question:
    values = _values(rng)

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        found = outputs.get("values")
        return sum(map(_bits, found, values)) if isinstance(found, list) else 0

    return Question(inputs={"nodes": list(_NODES)}, pokes=_pokes(values), bits=bits)


def _reach(**inputs: object) -> Callable[[random.Random], Question]:
    return lambda rng: Question(inputs=inputs, bits=exchanged)


def _restore(image: Image) -> tuple[Mapping[str, object], ...]:
    return _pokes([image["points"][node] for node in _NODES])


_OBJECTS = "i=85"
"""The folder Objects, which every server has (OPC 10000-6, NodeIds)."""

PROOF = Proof(
    ways=(
        Way(operation="read_many", ask=_read_many),
        Way(operation="read", ask=_read_one),
        Way(operation="variables", ask=_reach(), weak=True),
        Way(operation="browse", ask=_reach(node=_OBJECTS), weak=True),
    ),
    restore=_restore,
    unreachable=(
        Call("read", {"node": _NODES[0]}),
        Call("read_many", {"nodes": list(_NODES)}),
        Call("browse", {"node": _OBJECTS}),
        Call("variables"),
    ),
)
