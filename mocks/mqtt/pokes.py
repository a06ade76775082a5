"""What the kit can do at the broker past its clients. The journal has these messages with origin ``kit``, on connection 0.

===============  =======================================================================================================
``publish``      ``{"topic", "payload" (base64), "qos": 0, "retain": false}``: any bytes, and any characters in the topic, also
                 U+0000; ``topic_bytes`` (base64) instead of ``topic`` for one that is no UTF-8
``burst``        ``{"topic": "flood/{n}", "count": 5000, "size": 0, "qos": 0, "retain": false, "rate_per_s": 0,
                 "brief": false}``: so many messages, as fast as possible or at a rate. ``{n}`` is the number of the message, from 0;
                 the payload is that number, filled with spaces to ``size`` bytes. It returns when the last one is published.
                 ``brief``, for QoS 0 only: in the place of their PUBLISH packets the journal has one entry ``BURST`` with the
                 ``count`` that were published, and then one for each connection with the ``count`` that were sent to it
``answering``    a message as of ``publish``: it is published a tenth of a second after each SUBACK for a filter that its topic matches,
                 until the broker is reset, as a sensor does that reports often
``command``      ``{"group", "edge_node", "device": null, "metrics": […]}``: a Sparkplug NCMD, with a device a DCMD, as a host sends
                 them. Metrics as in ``sparkplug_values``
``account``      who gets in: :mod:`..accounts`
``disconnect``   ``{"client_id": null, "reason_code": 139}``: ends the connection of one client, or of all
===============  =======================================================================================================
"""

from __future__ import annotations

import base64
import binascii
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pytest_otmcp.wire.mqtt.packets import Publish
from pytest_otmcp.wire.mqtt.primitives import ProtocolViolation
from pytest_otmcp.wire.mqtt.topics import check_name

from ..fault_rules import FLAG, TEXT, Field, integer, number
from .sparkplug import encode_payload
from .sparkplug_values import metric

__all__ = ["BURST_TURN", "Burst", "command", "disconnection", "message"]

BURST_TURN = 500
"""Messages that are published before the connections get their turn."""

_QOS = integer(0, 2)
_REASONS = integer(0x80, 0xFF)
_TEXT_OR_NULL = Field(accepts=lambda value: value is None or isinstance(value, str), expected="a string or null")


def _read(name: str, source: Any, fields: Mapping[str, Field], required: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the members of a poke.

    Raises:
        ValueError: one is missing, unknown or has a value that it cannot have.
    """
    if not isinstance(source, Mapping) or not set(required) <= source.keys():
        raise ValueError(
            f"{name}: expected an object with {', '.join(required) or ', '.join(fields)}, found {source!r}"
        )
    for member, value in source.items():
        if member not in fields:
            raise ValueError(f"{name}: unknown member {member!r}; known are {', '.join(fields)}")
        if not fields[member].accepts(value):
            raise ValueError(f"{name}: {member} cannot be {value!r}: expected {fields[member].expected}")
    return dict(source)


def message(source: Any) -> Publish:
    """Return the message that a poke publishes.

    Raises:
        ValueError: it is not understood.
    """
    if not isinstance(source, Mapping) or "payload" not in source or not {"topic", "topic_bytes"} & source.keys():
        raise ValueError("an MQTT poke is {'publish': {'topic': …, 'payload': base64, 'qos': 0, 'retain': false}}")
    qos = source.get("qos", 0)
    if qos not in (0, 1, 2):
        raise ValueError(f"qos: expected 0, 1 or 2, found {qos!r}")
    try:
        if "topic_bytes" in source:
            topic = base64.b64decode(source["topic_bytes"], validate=True).decode("utf-8", "surrogateescape")
        else:
            topic = str(source["topic"])
        check_name(topic)
        payload = base64.b64decode(source["payload"], validate=True)
    except (ProtocolViolation, binascii.Error) as error:
        raise ValueError(str(error)) from None
    return Publish(topic=topic, payload=payload, qos=qos, retain=bool(source.get("retain", False)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Burst:
    """Many messages in a row; see the head of this file."""

    topic: str
    count: int
    size: int = 0
    qos: int = 0
    retain: bool = False
    rate_per_s: float = 0.0
    brief: bool = False

    @classmethod
    def of(cls, source: Any) -> Burst:
        """Read a poke.

        Raises:
            ValueError: it is not understood.
        """
        fields = {
            "topic": TEXT,
            "count": integer(1, 100_000),
            "size": integer(0, 65_536),
            "qos": _QOS,
            "retain": FLAG,
            "rate_per_s": number(0, 1_000_000),
            "brief": FLAG,
        }
        burst = cls(**_read("burst", source, fields, ("topic", "count")))
        if burst.brief and burst.qos:
            raise ValueError(f"burst: brief is for QoS 0, found QoS {burst.qos}")
        try:
            check_name(burst.topic)
        except ProtocolViolation as error:
            raise ValueError(str(error)) from None
        return burst

    def message(self, number: int) -> Publish:
        """Return the message with this number."""
        topic = self.topic.replace("{n}", str(number))
        payload = str(number).encode().ljust(self.size)
        return Publish(topic=topic, payload=payload, qos=self.qos, retain=self.retain)


def command(source: Any) -> Publish:
    """Return the Sparkplug command that a poke sends.

    Raises:
        ValueError: it is not understood.
    """
    a_list = Field(accepts=lambda value: isinstance(value, list), expected="a list of metrics")
    fields = {"group": TEXT, "edge_node": TEXT, "device": _TEXT_OR_NULL, "metrics": a_list}
    values = _read("command", source, fields, ("group", "edge_node", "metrics"))
    device = values.get("device")
    topic = f"spBv1.0/{values['group']}/{'NCMD' if device is None else 'DCMD'}/{values['edge_node']}"
    metrics = [metric(one) for one in values["metrics"]]
    # Commands have no sequence number (tck-id-payloads-ncmd-seq, -dcmd-seq).
    payload = encode_payload(metrics, timestamp=time.time_ns() // 1_000_000, seq=None)
    return Publish(topic=topic if device is None else f"{topic}/{device}", payload=payload, qos=0, retain=False)


def disconnection(source: Any) -> tuple[str | None, int]:
    """Return whom a poke disconnects, None for everybody, and the reason code.

    Raises:
        ValueError: it is not understood.
    """
    values = _read("disconnect", source, {"client_id": _TEXT_OR_NULL, "reason_code": _REASONS}, ("reason_code",))
    return values.get("client_id"), values["reason_code"]
