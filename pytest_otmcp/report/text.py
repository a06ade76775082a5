"""Text from outside, made harmless for whoever reads it. Pure.

Everything in a run record may have been written by the adapter under test: its messages, its tool names, its topics.
"""

from __future__ import annotations

__all__ = ["clipped", "printable", "shortened"]


def printable(text: str, keep: str = "") -> str:
    """The text with every letter that is not printable, but those to ``keep``, replaced by its escape.

    Control characters could colour a terminal or forge a line; those that turn the reading direction could make a
    browser show something else than what is there.
    """
    return "".join(letter if letter.isprintable() or letter in keep else repr(letter)[1:-1] for letter in text)


def clipped(text: str, limit: int) -> str:
    """At most ``limit`` characters of a text, and how many there were."""
    return text if len(text) <= limit else f"{text[:limit]}… ({len(text)} characters, all are in run.json)"


def shortened(text: str, width: int) -> str:
    """As much of a text as fits a line of a terminal, made printable."""
    text = printable(text)
    return text if len(text) <= width else text[: width - 3].rstrip() + "..."
