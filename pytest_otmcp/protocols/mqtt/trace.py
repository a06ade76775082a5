"""What an exchange with an MQTT broker gives ``meta.trace`` to say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..journal import JournalEntry
from .entries import as_mqtt

__all__ = ["facts"]


def facts(entry: JournalEntry) -> Mapping[str, Sequence[object]]:
    """Return what a packet says of the members ``topic``, ``qos``, ``retain``, ``packet_id`` and ``granted_qos``."""
    packet = as_mqtt(entry)
    if packet["kind"] == "PUBLISH" and packet["direction"] == "in":
        return {
            "topic": [packet["topic"]],
            "qos": [packet["qos"]],
            "retain": [packet["retain"]],
            **({"packet_id": [packet["packet_id"]]} if packet["qos"] else {}),
        }
    if packet["kind"] == "SUBSCRIBE":
        filters = packet["filters"]
        return {"topic": [wanted["filter"] for wanted in filters], "qos": [wanted["qos"] for wanted in filters]}
    if packet["kind"] == "UNSUBSCRIBE":
        return {"topic": [unwanted["filter"] for unwanted in packet["filters"]]}
    if packet["kind"] == "SUBACK":
        return {"granted_qos": packet["reason_codes"]}
    return {}
