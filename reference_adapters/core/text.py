"""Text that came from a device: shortened, cleaned of characters that mislead displays and models, marked as untrusted."""

from __future__ import annotations

import unicodedata
from typing import Any

from .call import Call

__all__ = ["device_text"]

_LONGEST = 1024
_REPLACEMENT = "\N{REPLACEMENT CHARACTER}"


def device_text(call: Call, pointer: str, text: Any) -> str:
    """Return text for ``data`` and list it in ``meta.untrusted``, so that a client knows that a device supplied it.

    Control, format and private characters (terminal escapes, bidirectional overrides, zero-width and tag characters)
    become U+FFFD; ``meta.sanitised`` says so.

    Args:
        call: the call that returns the text.
        pointer: JSON Pointer to the text in the envelope.
        text: a str, or bytes that should be UTF-8.
    """
    decoded = text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
    clean = "".join(
        _REPLACEMENT if unicodedata.category(character).startswith("C") else character
        for character in decoded[:_LONGEST]
    )
    call.extra.setdefault("untrusted", []).append(pointer)
    if clean != decoded:
        call.extra["sanitised"] = True
    return clean
