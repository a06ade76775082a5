"""Function codes and their names (Modbus Application Protocol Specification V1.1b3, section 6)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["FUNCTIONS", "title"]

FUNCTIONS: Mapping[int, str] = {
    1: "read coils",
    2: "read discrete inputs",
    3: "read holding registers",
    4: "read input registers",
    5: "write single coil",
    6: "write single register",
    15: "write multiple coils",
    16: "write multiple registers",
    22: "mask write register",
    23: "read/write multiple registers",
}


def title(entry: Mapping[str, Any]) -> str:
    """Name the kind of a journal entry, with its function where the specification names it."""
    kind, function = str(entry.get("kind")), entry.get("function")
    name = FUNCTIONS.get(function) if isinstance(function, int) else None
    return kind if name is None else f"{kind}: {name}"
