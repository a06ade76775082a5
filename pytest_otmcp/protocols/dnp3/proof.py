"""The proof that a session talks to the mock outstation: random values come back."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping

from ..journal import Entries, Image
from ..proof import Call, Proof, Question, Way, exchanged

__all__ = ["PROOF"]

_OUTSTATION = 10
_LEVEL, _ALIAS = "analog_input/1", "otmcp_level"
_ANALOG = {"outstation": _OUTSTATION, "start": 1, "count": 1}
_FIRST, _COUNT = 8, 8
_CONTACTS = [f"binary_input/{index}" for index in range(_FIRST, _FIRST + _COUNT)]
"""Binary inputs that make no events."""
_BINARY = {"outstation": _OUTSTATION, "start": _FIRST, "count": _COUNT}


def _number(inputs: Mapping[str, object], output: str) -> Callable[[random.Random], Question]:
    def ask(rng: random.Random) -> Question:
        value = rng.getrandbits(32) - 2**31

        def bits(outputs: Mapping[str, object], entries: Entries) -> int:
            found = outputs.get(output)
            first = found[0] if isinstance(found, list) and len(found) == 1 else found
            return 32 if not isinstance(first, bool) and first == value else 0

        return Question(inputs=inputs, pokes=({"point": _LEVEL, "value": value},), bits=bits)

    return ask


def _contacts(rng: random.Random) -> Question:
    states = [bool(rng.getrandbits(1)) for _ in _CONTACTS]

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        return _COUNT if outputs.get("values") == states else 0

    pokes = tuple({"point": name, "value": state} for name, state in zip(_CONTACTS, states, strict=True))
    return Question(inputs=_BINARY, pokes=pokes, bits=bits)


def _restore(image: Image) -> tuple[Mapping[str, object], ...]:
    return tuple({"point": name, "value": image["points"][name]} for name in (_LEVEL, *_CONTACTS))


PROOF = Proof(
    ways=(
        Way(operation="read_analog", ask=_number(_ANALOG, "values")),
        Way(operation="read_alias", ask=_number({"name": _ALIAS}, "value")),
        Way(operation="read_binary", ask=_contacts),
        Way(operation="ping", ask=lambda rng: Question(inputs={}, bits=exchanged), weak=True),
    ),
    restore=_restore,
    unreachable=(
        Call("read_analog", _ANALOG),
        Call("read_alias", {"name": _ALIAS}),
        Call("read_binary", _BINARY),
        Call("poll", {"outstation": _OUTSTATION, "event_class": 0}),
        Call("ping"),
    ),
)
