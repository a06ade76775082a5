"""Steps that the checks on MQTT and on Sparkplug B share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pytest_otmcp.protocols.journal import ADAPTER, Entries
from pytest_otmcp.protocols.mqtt.entries import MqttEntry, adapter_packets, payload_of
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.wire.mqtt.sparkplug import decode_message

__all__ = ["Messages", "edge_node_of", "nonce", "sparkplug", "speaks_mqtt_5", "until", "until_it_works"]

Messages = list[tuple[MqttEntry, Mapping[str, Any]]]
"""Sparkplug messages: the packet, and what the kit's own decoder makes of its payload."""

_LEVEL_5 = 5
_WAKING_S = 0.5
"""Seconds to wait for a new connection before an adapter is asked again."""


def nonce(run: Repetition) -> str:
    """Return a name that nothing had before."""
    return f"{run.rng.getrandbits(48):012x}"


def speaks_mqtt_5(entries: Entries) -> bool:
    """Tell whether connections of the adapter's are of MQTT 5."""
    connects = [entry for entry in entries if entry["kind"] == "CONNECT" and entry["origin"] == ADAPTER]
    return any(entry.get("protocol_level") == _LEVEL_5 for entry in connects)


def sparkplug(entries: Entries, *types: str) -> Messages:
    """Return the Sparkplug messages of these types, or of all, that the adapter published, in their order.

    What is no Sparkplug payload is left out: the session's oracle finds it.
    """
    decoded = (
        (packet, decode_message(packet["topic"], payload_of(packet)))
        for packet in adapter_packets(entries, "PUBLISH", "in")
    )
    return [
        (packet, message)
        for packet, message in decoded
        if message is not None and "error" not in message and (not types or message["type"] in types)
    ]


def edge_node_of(entries: Entries, device: str) -> tuple[str, str] | None:
    """Return group and name of the edge node that published for a device last; None if there is none."""
    found = [
        (message["group"], message["edge_node"]) for _, message in sparkplug(entries) if message["device"] == device
    ]
    return found[-1] if found else None


async def until(mqtt: Rig, there: Callable[[Entries], bool], *, timeout_s: float = 1.0) -> bool:
    """Wait for a PUBLISH of the adapter after which the journal is as expected; return whether it is."""
    while not there(await mqtt.journal()):
        count = len(adapter_packets(await mqtt.journal(), "PUBLISH", "in")) + 1
        if len(await mqtt.wait_for(kind="PUBLISH", direction="in", count=count, timeout_s=timeout_s)) < count:
            return there(await mqtt.journal())
    return True


async def until_it_works(run: Repetition, mqtt: Rig, operation: str, **inputs: Any) -> Reply:
    """Perform an operation after the broker has cut the connection: again with each new connection of the adapter, or after a
    while, for as long as the subject says that it takes to come back. Return the last reply; it has to be a success."""
    for _ in range(1 + int(mqtt.subject.recovery_s / _WAKING_S)):
        count = len(adapter_packets(await mqtt.journal(), "CONNECTED"))
        reply = await mqtt.call(operation, role="recovery", **inputs)
        if reply.success:
            break
        await mqtt.wait_for(kind="CONNECTED", count=count + 1, timeout_s=_WAKING_S)
    run.succeeds(reply, requirement="REC-001")
    return reply
