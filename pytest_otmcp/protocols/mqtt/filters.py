"""Topic filters. Pure."""

from __future__ import annotations

__all__ = ["covers", "name_in"]


def name_in(text: object) -> str | None:
    """Return the one topic that a filter selects; None for a filter with a wildcard."""
    return text if isinstance(text, str) and not {"+", "#"} & set(text) else None


def covers(text: str, other: str) -> bool:
    """Tell whether a topic filter selects this topic, or all that another filter selects (MQTT 3.1.1, section 4.7)."""
    wanted, levels = text.split("/"), other.split("/")
    if other.startswith("$") != text.startswith("$"):
        return False
    for index, level in enumerate(wanted):
        if level == "#":
            return True
        if index == len(levels) or levels[index] == "#" or level not in ("+", levels[index]):
            return False
    return len(wanted) == len(levels)
