"""A BACnet/IP device: strict server, objects with priority arrays, 1 Hz dynamics, faults on demand."""

from __future__ import annotations

from ..endpoint import Endpoint
from .device import BacnetDevice

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="bacnet", kind="udp"),)


def warm() -> None:
    """Do nothing: nothing is slow here."""


def create() -> BacnetDevice:
    """Return a fresh device 12345."""
    return BacnetDevice()
