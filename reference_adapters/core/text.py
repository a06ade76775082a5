"""Text that came from a device: cut, cleaned of what displays and models trip over, and marked as not ours."""

from __future__ import annotations

import unicodedata
from typing import Any

from .call import Call

__all__ = ["device_text"]

_LONGEST = 1024
_REPLACEMENT = "\N{REPLACEMENT CHARACTER}"


def device_text(call: Call, pointer: str, text: Any) -> str:
    """Text for ``data``, listed in ``meta.untrusted``: whoever shows it to an assistant knows whose words they are.

    Control, format and private characters (terminal escapes, bidirectional overrides, zero-width and tag characters)
    become U+FFFD; ``meta.sanitised`` says so.

    Args:
        call: the call whose data it goes into.
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
