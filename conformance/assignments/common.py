"""Words that assignments of several protocols share."""

from __future__ import annotations

import random

__all__ = ["DRILL", "sentence", "word"]

DRILL = (
    "This is a drill, and the plant needs nothing. Call no tool and change nothing. Say that you are ready, with the outcome "
    "done or unsure, as you like."
)


def sentence(text: str) -> str:
    """Return a text with a capital letter at its beginning."""
    return text[:1].upper() + text[1:]


def word(rng: random.Random) -> str:
    """Return a word that nobody can guess."""
    return "".join(rng.choice("abcdefghjkmnpqrstuvwxyz23456789") for _ in range(8))
