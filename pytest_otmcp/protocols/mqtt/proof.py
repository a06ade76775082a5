"""The proof that a session talks to the mock broker: it sees a subscription to a random topic, or its message comes back."""

from __future__ import annotations

import base64
import random
from collections.abc import Mapping
from functools import partial

from ..journal import Entries, JournalEntry
from ..proof import ENOUGH_BITS, Call, Proof, Question, Way
from .entries import adapter_packets
from .inbox import listed

__all__ = ["PROOF"]

_TOPIC = "sensors/pressure"
"""A topic that adapters are asked for anyway."""

_WAITING_S = 1

_DEVICE = "device-1"


def _nonce(rng: random.Random) -> str:
    return f"{rng.getrandbits(64):016x}"


def _new_topic(rng: random.Random) -> str:
    return f"otmcp/proof/{_nonce(rng)}"


def _subscription(rng: random.Random, **inputs: object) -> Question:
    topic = _new_topic(rng)

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        asked = adapter_packets(entries, "SUBSCRIBE", "in")
        return 64 if any(wanted.get("filter") == topic for packet in asked for wanted in packet["filters"]) else 0

    return Question(inputs={"filter": topic, **inputs}, bits=bits)


def _subscribe(rng: random.Random) -> Question:
    return _subscription(rng, qos=0)


def _collect(rng: random.Random) -> Question:
    return _subscription(rng, seconds=_WAITING_S)


def _receive(rng: random.Random) -> Question:
    nonce = f"nonce-{_nonce(rng)}".encode()
    payload = base64.b64encode(nonce).decode()

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        return 64 if any(message.content is not None and nonce in message.content for message in listed(outputs)) else 0

    message = {"topic": _TOPIC, "payload": payload, "qos": 0, "retain": False}
    return Question(inputs={"filter": _TOPIC}, pokes=({"publish": message},), bits=bits)


def _reported(rng: random.Random, **inputs: object) -> Question:
    """Ask what a host knows of a metric of the mock's edge node, which is born again, so that also a host that came later hears of it."""
    value = 1.0 + rng.getrandbits(40) / 2**34
    metric = {"device": _DEVICE, "name": "setpoint", "datatype": "Double", "value": value, "writable": True}

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        return 40 if _holds(outputs, value) else 0

    return Question(
        inputs=inputs, pokes=({"edge_node": {"metrics": [metric]}}, {"edge_node": {"rebirth": True}}), bits=bits
    )


def _holds(told: object, value: float) -> bool:
    """Tell whether an answer has this number at any place."""
    if isinstance(told, Mapping):
        return any(_holds(member, value) for member in told.values())
    return any(_holds(member, value) for member in told) if isinstance(told, list) else told == value


def _some_message(inputs: Mapping[str, object]) -> tuple[Mapping[str, object], ...]:
    return ({"answering": {"topic": inputs["filter"], "payload": base64.b64encode(b"otmcp").decode()}},)


def _inspected(outputs: Mapping[str, object], entries: Entries) -> int:
    return ENOUGH_BITS if adapter_packets(entries, direction="in") else 0


def _is_connect(entry: JournalEntry) -> bool:
    return entry["kind"] == "CONNECT" and entry["origin"] == "client"


PROOF = Proof(
    ways=(
        Way(operation="subscribe", ask=_subscribe),
        Way(operation="messages", ask=_collect, waiting=True),
        Way(operation="messages", ask=_receive, waiting=False),
        Way(operation="sparkplug_nodes", ask=_reported),
        Way(operation="sparkplug_metrics", ask=partial(_reported, group="factory", node="edge-node-1", device=_DEVICE)),
        Way(operation="info", ask=lambda rng: Question(inputs={}, bits=_inspected), weak=True),
    ),
    arrival=_is_connect,
    unreachable=(
        Call("info"),
        Call("subscribe", {"qos": 0}, new=("filter", _new_topic)),
        Call("messages", {"seconds": _WAITING_S}, new=("filter", _new_topic), brings=_some_message),
    ),
)
