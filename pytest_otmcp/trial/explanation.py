"""What an item asks, in words: read from the docstrings of its steps. Pure.

The first paragraph of a docstring says what is asked. Paragraphs or lines that begin with ``Said:``, ``Seen:`` and ``Why:`` say
what the answer must say, what the device must have seen, and why that is asked::

    async def ping(run: Repetition, rig: Rig) -> None:
        \"\"\"Ask whether the device can be reached.

        Said: success, and that it can.
        Seen: at least one request, which the device answered.
        Why: a status from memory would still say so when the plant has gone.
        \"\"\"
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Explanation", "explanation"]

_LABEL = re.compile(r"^(Said|Seen|Why): +", re.MULTILINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Explanation:
    """Steps in words; what the docstring does not say is empty.

    Attributes:
        asked: what the assistant asks for.
        said: what the answer must say.
        seen: what the device must have seen.
        why: what would go wrong in a plant otherwise.
    """

    asked: str = ""
    said: str = ""
    seen: str = ""
    why: str = ""


def explanation(steps: Callable[..., object] | None) -> Explanation:
    """Return steps in words; an empty explanation where there are no steps, or nothing is said of them."""
    text = inspect.cleandoc((steps.__doc__ if steps is not None else None) or "")
    asked, *labelled = _LABEL.split(text)
    parts = {label.lower(): _sentence(part) for label, part in zip(labelled[::2], labelled[1::2], strict=True)}
    return Explanation(asked=_sentence(asked), **parts)


def _sentence(text: str) -> str:
    line = " ".join(text.split())
    return line[:1].upper() + line[1:]
