"""Topic names and filters, checked before anything is sent (MQTT 3.1.1, section 4.7)."""

from __future__ import annotations

from ..core import AdapterError

__all__ = ["check_filter", "check_name", "matches"]

MAX_BYTES = 65535


def _refuse(message: str) -> AdapterError:
    return AdapterError("invalid_input", message, field="/topic")


def _check_text(text: str) -> None:
    if not text:
        raise _refuse("the topic is empty")
    if "\0" in text or any("\ud800" <= character <= "\udfff" for character in text):
        raise _refuse("the topic holds a character that MQTT does not allow")
    if len(text.encode()) > MAX_BYTES:
        raise _refuse("the topic is longer than 65535 bytes")


def check_name(topic: str) -> None:
    """A topic to publish on.

    Raises:
        AdapterError: ``invalid_input``.
    """
    _check_text(topic)
    if "+" in topic or "#" in topic:
        raise _refuse("a topic to publish on must not hold the wildcards + or #")
    if topic.startswith("$"):
        raise _refuse("topics beginning with $ belong to the broker")


def check_filter(text: str) -> None:
    """A topic filter to subscribe to.

    Raises:
        AdapterError: ``invalid_input``.
    """
    _check_text(text)
    levels = text.split("/")
    for index, level in enumerate(levels):
        if ("#" in level and (level != "#" or index != len(levels) - 1)) or ("+" in level and level != "+"):
            raise _refuse("wildcards stand alone in their level, and # only in the last")


def matches(text: str, topic: str) -> bool:
    """The filter selects the topic."""
    if topic.startswith("$") and text[:1] in ("+", "#"):
        return False
    wanted, levels = text.split("/"), topic.split("/")
    for index, level in enumerate(wanted):
        if level == "#":
            return True
        if index >= len(levels) or level not in ("+", levels[index]):
            return False
    return len(wanted) == len(levels)
