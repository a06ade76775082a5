"""The tools of an adapter as the console shows them: what each may do, by whose word, and its form. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from ..subject.model import Adapter
from ..subject.tools import bound, only_reads
from .form import fields

__all__ = ["described"]


def described(adapter: Adapter, listed: Mapping[str, Mapping[str, object]]) -> list[dict[str, object]]:
    """Return the tools of a session for the page.

    Args:
        listed: name to entry of ``tools/list``.
    """
    return [_described(adapter, name, entry) for name, entry in listed.items()]


def _described(adapter: Adapter, name: str, entry: Mapping[str, object]) -> dict[str, object]:
    annotations = entry.get("annotations")
    hint = annotations.get("readOnlyHint") if isinstance(annotations, dict) else None
    operations = sorted({operation for operation, _ in bound(adapter, name)})
    if operations:
        writes, by = not only_reads(adapter, name), f"bound to {', '.join(operations)}"
    elif isinstance(hint, bool):
        writes, by = not hint, f"its annotation readOnlyHint is {str(hint).lower()}; no operation is bound to it"
    else:
        writes, by = True, "neither the subject file nor an annotation says that it only reads"
    return {
        "name": name,
        "description": str(entry.get("description") or ""),
        "writes": writes,
        "by": by,
        "fields": [asdict(field) for field in fields(entry.get("inputSchema"))],
    }
