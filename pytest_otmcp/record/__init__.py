"""The run record ``run.json``: its shape, reading and writing it, device images, secrets. Pure."""

from __future__ import annotations

from .reader import RecordError, load

__all__ = ["RecordError", "load"]
