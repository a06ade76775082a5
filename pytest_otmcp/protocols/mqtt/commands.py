"""Which of an adapter's publications command the plant; what else it publishes is its own affair.

A Sparkplug host asks for births by a command that it may send by itself, to a node that it does not know
(tck-id-operational-behavior-host-reordering-rebirth): it moves nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...core.strict_json import same_json
from ...wire.mqtt.sparkplug import decode_message, parse_topic
from ..journal import JournalEntry
from ..protocol import Declared
from .entries import as_mqtt, payload_of
from .filters import covers

__all__ = [
    "COMMAND_TOPICS",
    "REBIRTH",
    "SCAN_RATE",
    "asks_for_births",
    "commands",
    "declares",
    "is_sparkplug_command",
]

COMMAND_TOPICS = "command_topics"
"""Key of the subject file: further topic filters below which the plant listens for commands."""

REBIRTH = "Node Control/Rebirth"
"""Name of the metric by which a node is asked for its births."""

SCAN_RATE = "Node Control/Scan Rate"
"""Name of the metric that says how often a node looks at its devices, in milliseconds (Int64)."""

_PLANT = "control/#"


def commands(entry: JournalEntry, declared: Declared) -> bool:
    """Tell whether a PUBLISH goes where the plant, or an edge node of it, listens for commands.

    Args:
        declared: what the subject file says of its adapter, by key.
    """
    topic = as_mqtt(entry)["topic"]
    sparkplug = parse_topic(topic)
    if sparkplug is not None:
        return sparkplug.type in ("NCMD", "DCMD") and not asks_for_births(entry)
    return any(covers(text, topic) for text in (_PLANT, *declared.get(COMMAND_TOPICS, ())))


def is_sparkplug_command(entry: JournalEntry, inputs: Mapping[str, Any]) -> bool:
    """Tell whether a PUBLISH is the NCMD or DCMD that these inputs of an operation ask for; a metric may have its alias alone."""
    message = as_mqtt(entry)
    decoded = decode_message(message["topic"], payload_of(message)) or {}
    if decoded.get("type") not in ("NCMD", "DCMD"):
        return False
    # Without a group in the inputs it is the adapter's own.
    asked = (inputs.get("group", decoded["group"]), inputs["node"], inputs.get("device"))
    return (decoded["group"], decoded["edge_node"], decoded["device"]) == asked and all(
        any(
            one["name"] in (None, metric["name"]) and same_json(one["value"], metric["value"])
            for one in decoded["metrics"]
        )
        for metric in inputs["metrics"]
    )


def asks_for_births(entry: JournalEntry) -> bool:
    """Tell whether a PUBLISH is a command that asks a node for its births and does nothing else."""
    message = as_mqtt(entry)
    decoded = decode_message(message["topic"], payload_of(message)) or {}
    asked = [(one["name"], one["value"]) for one in decoded.get("metrics", ())]
    return decoded.get("type") == "NCMD" and asked == [(REBIRTH, True)]


def declares(operation: str, effect: Mapping[str, str]) -> Mapping[str, list[str]]:
    """Return the topics of a named command: the plant listens there for commands."""
    return {COMMAND_TOPICS: [effect["topic"]]} if "topic" in effect else {}
