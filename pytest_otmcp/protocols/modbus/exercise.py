"""What checks for every protocol do on Modbus: holding registers of unit 1."""

from __future__ import annotations

import random

from ..exercise import Asked, Exercise, every_change

__all__ = ["EXERCISE"]

_READ, _WRITTEN = 20, 1
"""Registers that the tasks of the benchmark use as well, so that adapters with a list of their registers know them."""


def _read(rng: random.Random) -> Asked:
    value = rng.randrange(0x10000)
    poke = {"unit": 1, "table": "holding_registers", "address": _READ, "values": [value]}
    return Asked(
        operation="read_holding",
        inputs={"address": _READ, "count": 1},
        outputs={"values": [value]},
        pokes=(poke,),
    )


def _write(rng: random.Random) -> Asked:
    value = rng.randrange(2, 0x10000)
    return Asked(
        operation="write_holding",
        inputs={"address": _WRITTEN, "value": value},
        outputs={"value": value},
        points={f"1/holding_registers/{_WRITTEN}": value},
    )


EXERCISE = Exercise(
    reading="read_holding",
    read=_read,
    writing="write_holding",
    write=_write,
    number="value",
    bounded=("address", "count", "value"),
    done=every_change,
    reads=({"function": 3},),
    writes=({"function": 6}, {"function": 16}),
    silent=({"action": {"drop": True}},),
    reset=({"action": {"reset": True}},),
    refused=({"action": {"exception": 4}},),
)
