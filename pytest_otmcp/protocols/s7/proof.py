"""The proof that a session talks to the mock S7 controller: random bytes come back."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping

from ..journal import Entries, Image
from ..proof import Call, Proof, Question, Way, exchanged

__all__ = ["PROOF"]

_BLOCK = 10
_FIRST, _SIZE = 40, 4


def _bytes(rng: random.Random) -> Question:
    values = list(rng.randbytes(_SIZE))
    poke = {"area": f"DB{_BLOCK}", "byte": _FIRST, "data": bytes(values).hex()}

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        return 8 * _SIZE if outputs.get("values") == values else 0

    return Question(inputs={"db": _BLOCK, "start": _FIRST, "size": _SIZE}, pokes=(poke,), bits=bits)


def _number(kind: str, size: int) -> Callable[[random.Random], Question]:
    def ask(rng: random.Random) -> Question:
        value = rng.randrange(-(1 << 8 * size - 1), 1 << 8 * size - 1)
        poke = {"area": f"DB{_BLOCK}", "byte": _FIRST, "data": value.to_bytes(size, "big", signed=True).hex()}

        def bits(outputs: Mapping[str, object], entries: Entries) -> int:
            return 8 * size if outputs.get("value") == value else 0

        return Question(inputs={"db": _BLOCK, "start": _FIRST, "type": kind}, pokes=(poke,), bits=bits)

    return ask


def _restore(image: Image) -> tuple[Mapping[str, object], ...]:
    content = bytes.fromhex(image["areas"][f"DB{_BLOCK}"])
    return ({"area": f"DB{_BLOCK}", "byte": _FIRST, "data": content[_FIRST : _FIRST + _SIZE].hex()},)


PROOF = Proof(
    ways=(
        Way(operation="read_db", ask=_bytes),
        Way(operation="read_typed", ask=_number("DINT", 4)),
        Way(operation="read_typed", ask=_number("INT", 2)),
        Way(operation="ping", ask=lambda rng: Question(inputs={}, bits=exchanged), weak=True),
    ),
    restore=_restore,
    unreachable=(
        Call("read_db", {"db": _BLOCK, "start": 0, "size": 8}),
        Call("read_typed", {"db": _BLOCK, "start": 0, "type": "INT"}),
        Call("read_cpu_state"),
        Call("ping"),
    ),
)
