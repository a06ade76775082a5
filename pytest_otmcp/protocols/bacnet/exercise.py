"""What checks for every protocol do on BACnet: an analog input that is read, a commandable output that is written."""

from __future__ import annotations

import random

from ..exercise import Asked, Exercise
from ..journal import Entries, JournalEntry
from .entries import changes

__all__ = ["EXERCISE"]

_DEVICE, _PRIORITY = 12345, 8


def _read(rng: random.Random) -> Asked:
    # Halves below 2 to the 20 are exact in a REAL.
    value = rng.randrange(2**20) + 0.5
    return Asked(
        operation="read",
        inputs={"device": _DEVICE, "type": "analog-input", "instance": 1},
        outputs={"value": value},
        pokes=({"object": "analog-input,1", "value": value},),
    )


def _write(rng: random.Random) -> Asked:
    value = rng.randrange(2**20) + 0.5
    return Asked(
        operation="write",
        inputs={
            "device": _DEVICE,
            "type": "analog-output",
            "instance": 1,
            "value": value,
            "priority": _PRIORITY,
        },
        outputs={"value": value},
        points={"analog-output,1/present-value": value},
    )


def _done(entries: Entries, asked: Asked) -> list[JournalEntry]:
    return changes(entries)


EXERCISE = Exercise(
    reading="read",
    read=_read,
    writing="write",
    write=_write,
    number="value",
    bounded=("device", "instance", "value", "priority"),
    done=_done,
    reads=({"service": 12}, {"service": 14}),
    writes=({"service": 15},),
    silent=({"action": {"drop": True}},),
    # Datagrams have no connection that could be reset: what comes nearest is an answer that is lost.
    reset=({"action": {"drop": True}},),
    refused=({"action": {"error": [0, 25]}},),
)
