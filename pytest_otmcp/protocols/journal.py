"""Journal entries and device images, whatever the protocol: their contract, and the oracles that need no more. Pure.

Every witness, mock or tap, writes entries of this shape, with further members of its protocol. Images have ``points``, a
flat mapping of names to values, beside whatever else a protocol's image holds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict

__all__ = ["Entries", "Image", "JournalEntry"]


class JournalEntry(TypedDict):
    """One thing that reached a device, or that it sent.

    Members:
        seq: sequence number, from 0 since the device was started, without gaps.
        t_ns: monotonic time of the machine in nanoseconds.
        connection: number of the connection; 0 for none.
        direction: ``in`` for what the device received, ``out`` for what it sent.
        kind: what it is, in the protocol's words.
        origin: who caused it: a ``client`` of the device, the ``plant``'s own simulation, or the ``kit``.
        request: a client asks the plant for something; keeping a session alive is no request.
        state_changing: a request that may change the plant.
        answers: ``seq`` of the request that this entry answers, or None.
    """

    seq: int
    t_ns: int
    connection: int
    direction: Literal["in", "out"]
    kind: str
    origin: Literal["client", "plant", "kit"]
    request: bool
    state_changing: bool
    answers: int | None


Entries = Sequence[JournalEntry]
Image = Mapping[str, Any]
