"""The proof that a session talks to the mock PROFIBUS segment: random inputs come back."""

from __future__ import annotations

import random
from collections.abc import Mapping

from ..journal import Entries, Image
from ..proof import Call, Proof, Question, Way, exchanged

__all__ = ["PROOF"]

_WIDE, _WIDE_BYTES = 8, 8
_NARROW, _NARROW_BYTES = 5, 2
_ALIAS = "otmcp_counter"
"""Name that a launch of an adapter with names of its own has for the inputs of station 8 as one number of 64 bits."""
_READ = {"slave": _NARROW}


def _inputs(station: int, size: int, rng: random.Random) -> Question:
    content = rng.randbytes(size)

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        return 8 * size if outputs.get("values") == list(content) else 0

    return Question(inputs={"slave": station}, pokes=({"station": station, "inputs": content.hex()},), bits=bits)


def _number(rng: random.Random) -> Question:
    # Below 2 to the 53 every JSON number is exact.
    value = rng.getrandbits(53)

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        return 53 if outputs.get("value") == value else 0

    poke = {"station": _WIDE, "inputs": value.to_bytes(_WIDE_BYTES, "big").hex()}
    return Question(inputs={"name": _ALIAS}, pokes=(poke,), bits=bits)


def _restore(image: Image) -> tuple[Mapping[str, object], ...]:
    points = image["points"]
    return tuple(
        {
            "station": station,
            "inputs": bytes(points[f"{station}.input.{index}"] for index in range(size)).hex(),
        }
        for station, size in ((_WIDE, _WIDE_BYTES), (_NARROW, _NARROW_BYTES))
    )


PROOF = Proof(
    ways=(
        Way(operation="read_inputs", ask=lambda rng: _inputs(_WIDE, _WIDE_BYTES, rng)),
        Way(operation="read_inputs", ask=lambda rng: _inputs(_NARROW, _NARROW_BYTES, rng)),
        Way(operation="read_alias", ask=_number),
        Way(operation="ping", ask=lambda rng: Question(inputs={}, bits=exchanged), weak=True),
    ),
    restore=_restore,
    unreachable=(
        Call("read_inputs", _READ),
        Call("read_alias", {"name": _ALIAS}),
        Call("read_diagnosis", _READ),
        Call("ping"),
    ),
)
