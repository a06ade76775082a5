"""What checks for every protocol do on MQTT: a subscription to a topic of its own, and a publication at QoS 1."""

from __future__ import annotations

import random

from ..exercise import Asked, Exercise
from ..journal import Entries, JournalEntry
from .entries import messages, payload_of

__all__ = ["EXERCISE"]


_NOT_AUTHORISED = 0x87
"""Reason code of MQTT 5; a client of 3.1.1 is told its return code 5."""


def _read(rng: random.Random) -> Asked:
    return Asked(operation="subscribe", inputs={"filter": f"otmcp/check/{rng.getrandbits(32):08x}", "qos": 0})


def _write(rng: random.Random) -> Asked:
    inputs = {"topic": "control/pump", "payload": f"check-{rng.getrandbits(32):08x}", "qos": 1}
    return Asked(operation="publish", inputs=inputs)


def _published(entries: Entries, asked: Asked) -> list[JournalEntry]:
    wanted = str(asked.inputs["payload"]).encode()
    # What is delivered again, and marked so, is the same message.
    return [
        message
        for message in messages(entries)
        if message["topic"] == asked.inputs["topic"] and payload_of(message) == wanted
    ]


EXERCISE = Exercise(
    reading="subscribe",
    read=_read,
    writing="publish",
    write=_write,
    number=None,
    bounded=("qos",),
    done=_published,
    reads=({"packet": "SUBSCRIBE"},),
    writes=({"packet": "PUBLISH"},),
    silent=tuple({"packet": packet, "action": {"no_answer": True}} for packet in ("SUBSCRIBE", "PUBLISH")),
    reset=tuple({"packet": packet, "action": {"reset": True}} for packet in ("SUBSCRIBE", "PUBLISH")),
    refused=({"packet": "SUBSCRIBE", "action": {"reason_code": 0x80}},),
    unauthorised=({"packet": "CONNECT", "action": {"reason_code": _NOT_AUTHORISED}},),
    outside={"qos": (-1, 257, 2**31, 1.5, "0x1")},
)
