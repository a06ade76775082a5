"""Escaping of text from outside, which makes it harmless to show, and the grammar of counts. Pure."""

from __future__ import annotations

__all__ = ["counted", "printable"]


def counted(number: int, noun: str) -> str:
    """Write a number with its noun: ``1 run``, ``3 runs``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def printable(text: str, keep: str = "") -> str:
    """Replace every character that is not printable by its escape, except those in ``keep``.

    Control characters could colour a terminal or forge a line; characters that change the reading direction could make
    a browser show another text than the one that is there.
    """
    return "".join(letter if letter.isprintable() or letter in keep else repr(letter)[1:-1] for letter in text)
