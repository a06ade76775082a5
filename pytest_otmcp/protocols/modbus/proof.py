"""The proof that a session talks to the mock Modbus device: random registers come back."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, cast

from ..journal import Entries, Image
from ..proof import ENOUGH_BITS, REACHED, Call, Proof, Question, Way
from .tags import TAGS

__all__ = ["PROOF"]

_TABLES = ("input_registers", "holding_registers")
_REGISTERS = {0: 6, 18: 5}
"""First address to number of the registers that are set: more than are asked for, and the same in both tables. An adapter that
takes the neighbour's value or the other table's is wrong, but it is this device that it reads."""

_FIRST_STATE, _STATES = 30, 32
"""Coils and discrete inputs of no meaning in the plant."""
_TAG = "otmcp_scaled"

_CELLS = {
    "input_registers": _REGISTERS,
    "holding_registers": {**_REGISTERS, TAGS[_TAG].address: 1},
    "discrete_inputs": {_FIRST_STATE: _STATES},
    "coils": {_FIRST_STATE: _STATES},
}
"""First cell to number of the cells that a proof may change, by table."""

_BITS = 13
"""Random bits of a value that is found: one of six stands in a register by chance once in 10922 times, which is less than 2 to the -13."""


def _reading(first: int, inputs: Mapping[str, object]) -> Callable[[random.Random], Question]:
    def ask(rng: random.Random) -> Question:
        values = rng.sample(range(1, 0x10000), _REGISTERS[first])
        pokes = tuple({"unit": 1, "table": table, "address": first, "values": values} for table in _TABLES)

        def bits(outputs: Mapping[str, object], entries: Entries) -> int:
            found = outputs.get("values")
            # Each value counts once: registers that all hold the same are one chance, not four.
            return _BITS * sum(value in found for value in values) if isinstance(found, list) else 0

        return Question(inputs=inputs, pokes=pokes, bits=bits)

    return ask


def _typed(first: int) -> Callable[[random.Random], Question]:
    registers = _reading(first, {"address": first, "type": "uint32"})

    def ask(rng: random.Random) -> Question:
        asked = registers(rng)
        high, low = cast(Any, asked.pokes[0])["values"][:2]
        known = (high << 16 | low, low << 16 | high)
        return replace(asked, bits=lambda outputs, entries: ENOUGH_BITS if outputs.get("value") in known else 0)

    return ask


def _states(table: str) -> Callable[[random.Random], Question]:
    def ask(rng: random.Random) -> Question:
        values = [bool(rng.getrandbits(1)) for _ in range(_STATES)]
        poke = {"unit": 1, "table": table, "address": _FIRST_STATE, "values": values}

        def bits(outputs: Mapping[str, object], entries: Entries) -> int:
            return _STATES if outputs.get("values") == values else 0

        return Question(inputs=_BITS_ASKED, pokes=(poke,), bits=bits)

    return ask


def _tag(rng: random.Random) -> Question:
    tag, raw = TAGS[_TAG], rng.randrange(1, 0x8000)
    poke = {"unit": 1, "table": "holding_registers", "address": tag.address, "values": [raw]}

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        found = outputs.get("value")
        right = isinstance(found, int | float) and abs(found - raw * tag.scale) < tag.scale / 2
        return _BITS if right else 0

    return Question(inputs={"name": _TAG}, pokes=(poke,), bits=bits)


def _restore(image: Image) -> tuple[Mapping[str, object], ...]:
    points = image["points"]
    return tuple(
        {
            "unit": 1,
            "table": table,
            "address": first,
            "values": [points[f"1/{table}/{address}"] for address in range(first, first + count)],
        }
        for table in _CELLS
        for first, count in _CELLS[table].items()
    )


_INPUT, _HOLDING, _OTHER = {"address": 0, "count": 4}, {"address": 1, "count": 1}, {"address": 20, "count": 1}
"""Registers that the suite reads as well, so that adapters with a list of their registers know them."""
_BITS_ASKED = {"address": _FIRST_STATE, "count": _STATES}

PROOF = Proof(
    ways=(
        Way(operation="read_input", ask=_reading(0, _INPUT)),
        Way(operation="read_holding", ask=_reading(0, _HOLDING)),
        Way(operation="read_holding", ask=_reading(18, _OTHER)),
        Way(operation="read_discrete_inputs", ask=_states("discrete_inputs")),
        Way(operation="read_coils", ask=_states("coils")),
        Way(operation="read_typed", ask=_typed(18)),
        Way(operation="read_typed_input", ask=_typed(0)),
        Way(operation="read_tag", ask=_tag),
        REACHED,
    ),
    restore=_restore,
    unreachable=(
        Call("read_input", _INPUT),
        Call("read_holding", _HOLDING),
        Call("read_discrete_inputs", _BITS_ASKED),
        Call("read_coils", _BITS_ASKED),
        Call("read_typed", {"address": 18, "type": "uint32"}),
        Call("read_typed_input", {"address": 0, "type": "uint32"}),
        Call("read_tag", {"name": _TAG}),
        Call("ping"),
    ),
)
