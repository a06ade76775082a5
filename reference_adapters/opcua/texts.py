"""Texts that the server supplies. They are marked as untrusted place by place: an enumeration has thousands of texts."""

from __future__ import annotations

from collections.abc import Callable

from ..core import Call, device_text

__all__ = ["cleaner"]

_LONGEST = 1024


def cleaner(call: Call, pointer: str) -> Callable[[str | None], str]:
    """Return a function that cleans texts of the server; ``meta.untrusted`` then lists ``pointer``, their place in the data."""

    marked = False

    def clean(text: str | None) -> str:
        nonlocal marked
        if not text:
            return ""
        if not marked:
            untrusted: list[str] = call.extra.setdefault("untrusted", [])
            if pointer not in untrusted:
                untrusted.append(pointer)
            marked = True
        if len(text) <= _LONGEST and text.isascii() and text.isprintable():
            return text
        cleaned = device_text(call, pointer, text)
        call.extra["untrusted"].pop()
        return cleaned

    return clean
