"""The proof that a session talks to the mock Modbus device: random registers come back."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping

from ..journal import Entries, Image
from ..proof import Proof, Question, Way, exchanged

__all__ = ["PROOF"]

_TABLES = ("input_registers", "holding_registers")
_REGISTERS = {0: 6, 18: 5}
"""First address to number of the registers that are set: more than are asked for, and the same in both tables. An adapter that
takes the neighbour's value or the other table's is wrong, but it is this device that it reads."""


def _reading(first: int, inputs: Mapping[str, int]) -> Callable[[random.Random], Question]:
    def ask(rng: random.Random) -> Question:
        values = rng.sample(range(1, 0x10000), _REGISTERS[first])
        pokes = tuple({"unit": 1, "table": table, "address": first, "values": values} for table in _TABLES)

        def bits(outputs: Mapping[str, object], entries: Entries) -> int:
            found = outputs.get("values")
            return 16 * sum(value in values for value in found) if isinstance(found, list) else 0

        return Question(inputs=inputs, pokes=pokes, bits=bits)

    return ask


def _restore(image: Image) -> tuple[Mapping[str, object], ...]:
    points = image["points"]
    return tuple(
        {
            "unit": 1,
            "table": table,
            "address": first,
            "values": [points[f"1/{table}/{address}"] for address in range(first, first + count)],
        }
        for table in _TABLES
        for first, count in _REGISTERS.items()
    )


_INPUT, _HOLDING, _OTHER = {"address": 0, "count": 4}, {"address": 1, "count": 1}, {"address": 20, "count": 1}
"""Registers that the suite reads as well, so that adapters with a list of their registers know them."""

PROOF = Proof(
    ways=(
        Way(operation="read_input", ask=_reading(0, _INPUT)),
        Way(operation="read_holding", ask=_reading(0, _HOLDING)),
        Way(operation="read_holding", ask=_reading(18, _OTHER)),
        Way(operation="ping", ask=lambda rng: Question(inputs={}, bits=exchanged), weak=True),
    ),
    restore=_restore,
    unreachable=(("read_input", _INPUT), ("read_holding", _HOLDING), ("ping", {})),
)
