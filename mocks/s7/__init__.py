"""An S7 controller: strict server of classic S7 communication, data blocks and areas, 1 Hz dynamics, faults on demand."""

from __future__ import annotations

from ..endpoint import Endpoint
from .device import S7Device

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="s7", kind="tcp"),)


def warm() -> None:
    """Do nothing: nothing is slow here."""


def create() -> S7Device:
    """Return a fresh controller in rack 0, slot 1."""
    return S7Device()
