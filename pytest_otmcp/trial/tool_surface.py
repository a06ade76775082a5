"""What ``tools/list`` gives a model to read, counted when the tools are listed, so that a record need not keep every word. Pure."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping

from ..record.schema import ToolSurface

__all__ = ["surface"]

_UNSEEN = re.compile(
    r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200b\u202a-\u202e\u2060-\u2069\ufeff\U000e0000-\U000e007f]"
)
"""Characters that a person does not see, or that change the order in which others are seen. Joiners and marks that scripts and pictures
need (U+200C to U+200F) are none of them."""

_MOST_UNSEEN, _MOST_ARGUMENTS = 8, 200


def surface(entry: Mapping[str, object]) -> ToolSurface:
    """Return what a model reads of one tool.

    Args:
        entry: of ``tools/list``.
    """
    schema = entry.get("inputSchema")
    properties = schema.get("properties") if isinstance(schema, Mapping) else None
    description = entry.get("description")
    read = {name: entry.get(name) for name in ("name", "title", "description", "inputSchema")}
    unseen = dict.fromkeys(character for text in _texts(read) for character in _UNSEEN.findall(text))
    return {
        "described": isinstance(description, str) and bool(description.strip()),
        "unseen": [f"U+{ord(character):04X}" for character in unseen][:_MOST_UNSEEN],
        "arguments": sorted(map(str, properties))[:_MOST_ARGUMENTS] if isinstance(properties, Mapping) else [],
        "bytes": len(json.dumps(read, ensure_ascii=False, separators=(",", ":")).encode("utf-8", "replace")),
    }


def _texts(document: object) -> Iterator[str]:
    """Yield every text in a document, names of members included."""
    left = [document]
    while left:
        part = left.pop()
        if isinstance(part, str):
            yield part
        elif isinstance(part, Mapping):
            left += [*part, *part.values()]
        elif isinstance(part, list):
            left += part
