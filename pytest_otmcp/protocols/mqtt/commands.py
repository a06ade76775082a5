"""Which of an adapter's publications command the plant; what else it publishes is its own affair."""

from __future__ import annotations

from collections.abc import Mapping

from ..journal import JournalEntry
from ..protocol import Declared
from .entries import as_mqtt
from .filters import covers
from .sparkplug_decoder import parse_topic

__all__ = ["COMMAND_TOPICS", "commands", "declares"]

COMMAND_TOPICS = "command_topics"
"""Key of the subject file: further topic filters below which the plant listens for commands."""

_PLANT = "control/#"


def commands(entry: JournalEntry, declared: Declared) -> bool:
    """Tell whether a PUBLISH goes where the plant, or an edge node of it, listens for commands.

    Args:
        declared: what the subject file says of its adapter, by key.
    """
    topic = as_mqtt(entry)["topic"]
    sparkplug = parse_topic(topic)
    if sparkplug is not None:
        return sparkplug.type in ("NCMD", "DCMD")
    return any(covers(text, topic) for text in (_PLANT, *declared.get(COMMAND_TOPICS, ())))


def declares(operation: str, effect: Mapping[str, str]) -> Mapping[str, list[str]]:
    """Return the topics of a named command: the plant listens there for commands."""
    return {COMMAND_TOPICS: [effect["topic"]]} if "topic" in effect else {}
