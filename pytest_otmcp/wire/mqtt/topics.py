"""Topic names and filters (5: section 4.7 and 4.8.2, 3.1.1: section 4.7)."""

from __future__ import annotations

from .primitives import ProtocolViolation

__all__ = ["check_filter", "check_name", "matches", "split_shared"]

_SHARED = "$share/"


def check_name(topic: str) -> None:
    """Check a topic name: at least one character and no wildcard [MQTT-4.7.3-1, MQTT-3.3.2-2].

    Raises:
        ProtocolViolation: the text is no topic name.
    """
    if not topic:
        raise ProtocolViolation("the topic name is empty")
    if "+" in topic or "#" in topic:
        raise ProtocolViolation(f"the topic name {topic!r} contains a wildcard")


def check_filter(topic_filter: str) -> None:
    """Check a topic filter: wildcards occupy whole levels, ``#`` only the last [MQTT-4.7.1-1, MQTT-4.7.1-2].

    Raises:
        ProtocolViolation: the filter is malformed.
    """
    if not topic_filter:
        raise ProtocolViolation("the topic filter is empty")
    levels = topic_filter.split("/")
    for level in levels:
        if len(level) > 1 and ("+" in level or "#" in level):
            raise ProtocolViolation(f"in the topic filter {topic_filter!r} a wildcard shares a level")
    if "#" in levels[:-1]:
        raise ProtocolViolation(f"in the topic filter {topic_filter!r} the # is not at the end")


def split_shared(topic_filter: str) -> tuple[str | None, str]:
    """Return the share name, or None, and the filter proper of ``$share/{name}/{filter}`` [MQTT-4.8.2-1, MQTT-4.8.2-2].

    Raises:
        ProtocolViolation: the share name is empty or contains a wildcard, or no filter follows it.
    """
    if topic_filter != _SHARED[:-1] and not topic_filter.startswith(_SHARED):
        return None, topic_filter
    name, slash, proper = topic_filter[len(_SHARED) :].partition("/")
    if not name or "+" in name or "#" in name or not slash or not proper:
        raise ProtocolViolation(f"{topic_filter!r} is no shared subscription")
    return name, proper


def matches(filter_levels: list[str], topic_levels: list[str]) -> bool:
    """Tell whether a filter matches a topic, both split at ``/``.

    A wildcard in the first level does not match a topic that begins with ``$`` [MQTT-4.7.2-1].
    """
    if topic_levels[0].startswith("$") and filter_levels[0] in ("+", "#"):
        return False
    for index, level in enumerate(filter_levels):
        if level == "#":
            return True
        if index == len(topic_levels):
            return False
        if level not in ("+", topic_levels[index]):
            return False
    return len(filter_levels) == len(topic_levels)
