"""What a plant may ask of an adapter: each task says which of these it is about. Pure."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["Capability"]


class Capability(StrEnum):
    """Something that an adapter may be trusted with when everything about it has passed."""

    READING = "reading"
    WRITING = "writing"
    WRITE_PROTECTION = "write_protection"
    REFUSING = "refusing"
    LOAD = "load"
    OUTAGES = "outages"
