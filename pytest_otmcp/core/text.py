"""Text from outside, made harmless. Pure."""

from __future__ import annotations

__all__ = ["printable"]


def printable(text: str, keep: str = "") -> str:
    """Replace every letter that is not printable, but those to ``keep``, by its escape.

    Control characters could colour a terminal or forge a line; those that turn the reading direction could make a
    browser show something else than what is there.
    """
    return "".join(letter if letter.isprintable() or letter in keep else repr(letter)[1:-1] for letter in text)
