"""A buyer's question, from which the values of a run follow: so the run is newer than the question. Pure.

Whoever asks draws a nonce and keeps it until then. The seed of a run is taken from its digest, and the values that the run writes and
reads from the seed: a history that was made before has other ones.
"""

from __future__ import annotations

import hashlib
import re

__all__ = ["NONCE", "is_nonce", "seed_of"]

NONCE = "16 to 128 letters, digits and -_.:="
_NONCE = re.compile(r"[A-Za-z0-9_.:=-]{16,128}")
_SEPARATED = b"otmcp-challenge\0"


def is_nonce(text: str) -> bool:
    """Tell whether a text is a nonce: nobody guesses it, and it looks the same to everybody."""
    return _NONCE.fullmatch(text) is not None


def seed_of(nonce: str) -> int:
    """Return the seed that follows from a nonce: the first 63 bits of SHA-256, with the purpose in front."""
    return int.from_bytes(hashlib.sha256(_SEPARATED + nonce.encode()).digest()[:8], "big") >> 1
