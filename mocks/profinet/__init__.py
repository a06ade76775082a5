"""A PROFINET IO device: DCP, records by remote procedure calls, cyclic data of RT class 1 from 32 ms on, 1 Hz dynamics, faults on demand.

It is on a cable of its own (see ``cable``), and has a neighbour that answers DCP alone.
"""

from __future__ import annotations

from ..endpoint import Endpoint
from .device import ProfinetDevice

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="profinet", kind="cable"),)


def warm() -> None:
    """Do nothing: nothing is slow here."""


def create() -> ProfinetDevice:
    """Return a fresh device."""
    return ProfinetDevice()
