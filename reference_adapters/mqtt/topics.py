"""Topic names and filters, checked before anything is sent (MQTT 3.1.1, section 4.7)."""

from __future__ import annotations

from ..core import AdapterError

__all__ = ["NAMESPACE", "check_filter", "check_name", "matches"]

NAMESPACE = "spBv1.0"
"""First level of every Sparkplug B topic (Sparkplug 3.0, section 4.1.1)."""

_MAX_BYTES = 65535


def _refuse(message: str) -> AdapterError:
    return AdapterError("invalid_input", message, field="/topic")


def _check_text(text: str) -> None:
    if not text:
        raise _refuse("the topic is empty")
    if "\0" in text:
        raise _refuse("the topic holds U+0000, which MQTT does not allow")
    if len(text.encode()) > _MAX_BYTES:
        raise _refuse(f"the topic is longer than {_MAX_BYTES} bytes")


def check_name(topic: str) -> str:
    """Check a topic to publish on and return it.

    Raises:
        AdapterError: ``invalid_input``.
    """
    _check_text(topic)
    if "+" in topic or "#" in topic:
        raise _refuse("a topic to publish on must not hold the wildcards + or #")
    if topic.startswith("$"):
        raise _refuse("topics beginning with $ belong to the broker")
    if topic.split("/", 1)[0] == NAMESPACE:
        # A message that is published there by hand would break the sequence of an edge node.
        raise _refuse("topics of Sparkplug are published by the tools for edge nodes, devices and commands")
    return topic


def check_filter(text: str) -> str:
    """Check a topic filter to subscribe to and return it.

    Raises:
        AdapterError: ``invalid_input``.
    """
    _check_text(text)
    levels = text.split("/")
    if any(level not in ("+", "#") and ("+" in level or "#" in level) for level in levels) or "#" in levels[:-1]:
        raise _refuse("the wildcards + and # stand alone in their level, and # only in the last")
    if levels[0] == "$share":
        raise _refuse("a shared subscription would take messages away from whom they are meant for")
    return text


def matches(text: str, topic: str) -> bool:
    """Tell whether the filter selects the topic."""
    wanted, levels = text.split("/"), topic.split("/")
    if topic.startswith("$") and wanted[0] in ("+", "#"):
        return False
    for index, level in enumerate(wanted):
        if level == "#":
            return True
        if index >= len(levels) or level not in ("+", levels[index]):
            return False
    return len(wanted) == len(levels)
