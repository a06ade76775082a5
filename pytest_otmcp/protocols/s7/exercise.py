"""What checks for every protocol do on S7: INTs of the data block that belongs to the clients."""

from __future__ import annotations

import random

from ..exercise import Asked, Exercise, every_change
from .entries import points

__all__ = ["EXERCISE"]

_BLOCK, _READ, _WRITTEN = 10, 6, 2


def _read(rng: random.Random) -> Asked:
    value = rng.randrange(-0x8000, 0x8000)
    poke = {"area": f"DB{_BLOCK}", "byte": _READ, "data": value.to_bytes(2, "big", signed=True).hex()}
    return Asked(
        operation="read_typed",
        inputs={"db": _BLOCK, "start": _READ, "type": "INT"},
        outputs={"value": value},
        pokes=(poke,),
    )


def _write(rng: random.Random) -> Asked:
    value = rng.randrange(2, 0x8000)
    return Asked(
        operation="write_db",
        inputs={"db": _BLOCK, "start": _WRITTEN, "type": "INT", "value": value},
        outputs={"value": value},
        points=points(f"DB{_BLOCK}", _WRITTEN, value.to_bytes(2, "big")),
    )


EXERCISE = Exercise(
    reading="read_typed",
    read=_read,
    writing="write_db",
    write=_write,
    number="value",
    bounded=("db", "start"),
    done=every_change,
    reads=({"service": "read"},),
    writes=({"service": "write"},),
    silent=({"action": {"drop": True}},),
    reset=({"action": {"reset": True}},),
    refused=({"action": {"error": 0x8104}},),
)
