"""The proof that a session talks to the mock BACnet device: random present values come back."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping

from ..journal import Entries, Image
from ..proof import Call, Proof, Question, Way, exchanged

__all__ = ["PROOF"]

_DEVICE = 12345
_INPUT = {"device": _DEVICE, "type": "analog-input", "instance": 1}
_POINT, _OBJECT, _ALIAS = "analog-input,1/present-value", "analog-input,1", "otmcp_zone"
_BITS, _ROUNDED_BITS = 24, 17
"""Random bits of a value of 24 bits, and of one that an adapter has rounded to hundredths."""


def _reading(inputs: Mapping[str, object]) -> Callable[[random.Random], Question]:
    def ask(rng: random.Random) -> Question:
        # A REAL holds 24 bits exactly.
        value = rng.getrandbits(24) / 128

        def bits(outputs: Mapping[str, object], entries: Entries) -> int:
            found = outputs.get("value")
            if isinstance(found, bool) or not isinstance(found, int | float):
                return 0
            return _BITS if found == value else _ROUNDED_BITS if abs(found - value) <= 0.005 else 0

        return Question(inputs=inputs, pokes=({"object": _OBJECT, "value": value},), bits=bits)

    return ask


def _restore(image: Image) -> tuple[Mapping[str, object], ...]:
    return ({"object": _OBJECT, "value": image["points"][_POINT]},)


PROOF = Proof(
    ways=(
        Way(operation="read", ask=_reading(_INPUT)),
        Way(operation="read_alias", ask=_reading({"name": _ALIAS})),
        Way(operation="ping", ask=lambda rng: Question(inputs={}, bits=exchanged), weak=True),
    ),
    restore=_restore,
    unreachable=(
        Call("read", _INPUT),
        Call("read_alias", {"name": _ALIAS}),
        Call("list_objects", {"device": _DEVICE}),
        Call("ping"),
    ),
)
