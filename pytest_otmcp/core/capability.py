"""The capabilities of an adapter that a plant may rely on; each task names the one that it tests. Pure."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["Capability"]


class Capability(StrEnum):
    """A capability of an adapter; a plant may rely on it when every item about it has passed."""

    READING = "reading"
    WRITING = "writing"
    WRITE_PROTECTION = "write_protection"
    REFUSING = "refusing"
    LOAD = "load"
    OUTAGES = "outages"
