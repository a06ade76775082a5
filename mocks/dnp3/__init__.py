"""A DNP3 outstation: strict server of the functions that masters use, points with flags, events, 1 Hz dynamics, faults on demand."""

from __future__ import annotations

from ..endpoint import Endpoint
from .device import Dnp3Device

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="dnp3", kind="tcp"),)


def warm() -> None:
    """Do nothing: nothing is slow here."""


def create() -> Dnp3Device:
    """Return a fresh outstation with the link address 10."""
    return Dnp3Device()
