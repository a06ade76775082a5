"""What checks for every protocol do on MQTT: a subscription to a topic of its own, and a publication at QoS 1."""

from __future__ import annotations

import base64
import json
import random
import zlib
from collections.abc import Mapping
from functools import partial
from typing import Any

from ...core.strict_json import same_json
from ..exercise import Asked, DeviceText, Exercise, Limited, Waiting, Writing
from ..journal import Entries, JournalEntry
from .commands import SCAN_RATE, is_sparkplug_command
from .entries import as_mqtt, messages, payload_of

__all__ = ["EXERCISE"]


_NOT_AUTHORISED = 0x87
"""Reason code of MQTT 5; a client of 3.1.1 is told its return code 5."""


def _read(rng: random.Random) -> Asked:
    return Asked(operation="subscribe", inputs={"filter": f"otmcp/check/{rng.getrandbits(32):08x}", "qos": 0})


def _collect(rng: random.Random, seconds: int) -> Asked:
    """Wait for a message on a topic of its own, which comes when the broker has granted the filter; what the answer holds is judged by
    checks of its own."""
    topic = f"otmcp/check/{rng.getrandbits(32):08x}"
    message = {"topic": topic, "payload": base64.b64encode(f"check-{rng.getrandbits(32):08x}".encode()).decode()}
    return Asked(operation="messages", inputs={"filter": topic, "seconds": seconds}, pokes=({"answering": message},))


def _write(rng: random.Random) -> Asked:
    inputs = {"topic": "control/pump", "payload": f"check-{rng.getrandbits(32):08x}", "qos": 1}
    return Asked(operation="publish", inputs=inputs)


_EDGE_NODE = {"group": "factory", "node": "edge-node-1"}
"""The mock's node. It declares what is commanded here."""


def _device_command(rng: random.Random) -> Asked:
    setpoint = {"name": "setpoint", "datatype": "Double", "value": 1.0 + rng.getrandbits(40) / 2**34}
    inputs = {**_EDGE_NODE, "device": "device-1", "metrics": [setpoint]}
    return Asked(operation="send_device_command", inputs=inputs)


def _node_command(rng: random.Random) -> Asked:
    scan_rate = {"name": SCAN_RATE, "datatype": "Int64", "value": rng.randrange(1_000, 2**40)}
    return Asked(operation="send_node_command", inputs={**_EDGE_NODE, "metrics": [scan_rate]})


_NO_LEVELS = ("", "a/b", "a+", "#")
"""What is no single level of a topic (tck-id-topic-structure-namespace-valid-edge-node-id and its like)."""
_NO_TARGETS = {"group": _NO_LEVELS, "node": _NO_LEVELS}


def _tells(rng: random.Random) -> tuple[Asked, ...]:
    metrics = [{"name": "temperature", "value": rng.randrange(1, 2**20) + 0.5}]
    data = Asked(operation="device_data", inputs={"device": "device-1", "metrics": metrics})
    return (data, _device_command(rng), _node_command(rng))


def _published(entries: Entries, asked: Asked) -> list[JournalEntry]:
    # What is delivered again, and marked so, is the same message.
    if asked.operation != "publish":
        return [message for message in messages(entries) if is_sparkplug_command(message, asked.inputs)]
    return [
        message
        for message in messages(entries)
        if message["topic"] == asked.inputs["topic"]
        and _is_asked_for(payload_of(message), str(asked.inputs["payload"]))
    ]


def _is_asked_for(payload: bytes, wanted: str) -> bool:
    """Tell whether a payload is what was asked for; of a JSON object the members that were asked for, others are the adapter's own."""
    if payload == wanted.encode():
        return True
    try:
        stated, said = json.loads(wanted), json.loads(payload)
    except ValueError:
        return False
    return isinstance(stated, dict) and _has(said, stated)


def _has(said: object, stated: object) -> bool:
    if isinstance(stated, dict) and isinstance(said, dict):
        return all(name in said and _has(said[name], value) for name, value in stated.items())
    return same_json(said, stated)


def _says(entry: JournalEntry) -> Mapping[str, Any] | None:
    message = as_mqtt(entry)
    return {"qos": message.get("qos"), "retain": bool(message.get("retain"))} if message["kind"] == "PUBLISH" else None


def _too_late(entry: JournalEntry) -> str | None:
    """A message of QoS 0 has no acknowledgement that a success could wait for."""
    return "MQT-001" if as_mqtt(entry).get("qos") else None


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    topics = ("pump", "line-1/speed", "pump2", "pump/1", "line-1/axis-2/speed", "speed")
    command = [{"name": "setpoint", "datatype": "Double", "value": 42.5}]
    return (
        *(_publication(f"control/{topic}", f"check-{rng.getrandbits(32):08x}") for topic in topics),
        Asked(
            operation="send_node_command",
            inputs={"node": "otmcp-fenced", "metrics": command},
            points={"spBv1.0/NCMD/otmcp-fenced": command},
        ),
    )


def _message(topic: str, payload: str) -> dict[str, object]:
    return {"publish": {"topic": topic, "payload": base64.b64encode(payload.encode()).decode()}}


def _metric(name: str, value: str) -> dict[str, object]:
    return {"edge_node": {"metrics": [{"device": "device-1", "name": name, "datatype": "String", "value": value}]}}


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    below = f"otmcp/{name}"
    to_all, to_one, exchange = (
        Asked(operation="subscribe", inputs={"filter": f"{below}/{end}", "qos": 0}) for end in ("#", "text", "none")
    )

    def received(end: str, poke: dict[str, object]) -> Asked:
        return Asked(operation="messages", inputs={"filter": f"{below}/{end}"}, pokes=(poke,))

    def listed(poke: dict[str, object]) -> Asked:
        return Asked(operation="sparkplug_nodes", inputs={}, pokes=(poke,))

    births = Asked(operation="sparkplug_nodes", inputs={})
    return (
        DeviceText(
            place="a payload",
            ask=lambda text: received("text", _message(f"{below}/text", text)),
            longest=10_000,
            first=to_one,
            then=exchange,
        ),
        DeviceText(
            place="a topic",
            ask=lambda text: received("#", _message(f"{below}/{text}", "x")),
            longest=10_000,
            # MQTT 3.1.1, section 1.5.3: a receiver may close the connection for them.
            controls=False,
            first=to_all,
            then=exchange,
            output="messages.topic",
        ),
        DeviceText(
            place="the name of a metric",
            ask=lambda text: listed(_metric(text, "x")),
            longest=200,
            first=births,
            then=exchange,
        ),
        DeviceText(
            place="the value of a metric",
            ask=lambda text: listed(_metric("otmcp_text", text)),
            longest=10_000,
            first=births,
            then=exchange,
        ),
    )


def _texts_waited_for(name: str, seconds: int) -> tuple[DeviceText, ...]:
    def received(text: str, end: str, payload: str, filtered: str) -> Asked:
        # The broker sends a message whenever its filter is granted, so each text has a filter of its own.
        below = f"otmcp/{name}/{zlib.crc32(text.encode()):08x}{len(end):x}"
        message = {"topic": f"{below}/{end}", "payload": base64.b64encode(payload.encode()).decode()}
        return Asked(
            operation="messages",
            inputs={"filter": f"{below}/{filtered}", "seconds": seconds},
            pokes=({"answering": message},),
        )

    return (
        DeviceText(place="a payload", ask=lambda text: received(text, "text", text, "text"), longest=10_000),
        # MQTT 3.1.1, section 1.5.3: a receiver may close the connection for control characters.
        DeviceText(
            place="a topic",
            ask=lambda text: received(text, text, "x", "#"),
            longest=10_000,
            controls=False,
            output="messages.topic",
        ),
    )


def _publication(topic: str, payload: str) -> Asked:
    return Asked(operation="publish", inputs={"topic": topic, "payload": payload, "qos": 1}, points={topic: payload})


def _number(topic: str, value: float) -> Asked:
    return _publication(topic, f"{value:g}")


EXERCISE = Exercise(
    reading="subscribe",
    read=_read,
    waiting=Waiting(operation="messages", read=_collect, device_texts=_texts_waited_for),
    writing="publish",
    write=_write,
    otherwise=(
        Writing(operation="send_device_command", write=_device_command, outside={**_NO_TARGETS, "device": _NO_LEVELS}),
        Writing(operation="send_node_command", write=_node_command, outside=_NO_TARGETS),
    ),
    number=None,
    bounded=("qos",),
    done=_published,
    too_late=_too_late,
    reads=({"packet": "SUBSCRIBE"},),
    writes=({"packet": "PUBLISH"},),
    silent=tuple({"packet": packet, "action": {"no_answer": True}} for packet in ("SUBSCRIBE", "PUBLISH")),
    reset=tuple({"packet": packet, "action": {"reset": True}} for packet in ("SUBSCRIBE", "PUBLISH")),
    refused=({"packet": "SUBSCRIBE", "action": {"reason_code": 0x80}},),
    tells=_tells,
    fenced=_fenced,
    limited={
        topic: Limited(ways=(partial(_number, topic),), unit=0.5, given_as="payload")
        for topic in ("control/limited", "control/paced")
    },
    unauthorised=({"packet": "CONNECT", "action": {"reason_code": _NOT_AUTHORISED}},),
    says=_says,
    recognised={"publish": lambda entry, asked: bool(_published([entry], asked))},
    outside={"qos": (-1, 257, 2**31, 1.5, "0x1")},
    device_texts=_device_texts,
)
