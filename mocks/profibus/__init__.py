"""A PROFIBUS DP segment: three slaves on one serial line, which is a pseudo terminal; watchdogs, 1 Hz dynamics, faults on demand."""

from __future__ import annotations

from ..endpoint import Endpoint
from .device import ProfibusDevice

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="profibus", kind="pty"),)


def warm() -> None:
    """Do nothing: nothing is slow here."""


def create() -> ProfibusDevice:
    """Return a fresh segment."""
    return ProfibusDevice()
