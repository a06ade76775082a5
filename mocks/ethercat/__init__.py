"""An EtherCAT segment: two slaves in a row on a cable of their own, with state machines, objects, process data and watchdogs."""

from __future__ import annotations

from ..endpoint import Endpoint
from .device import EthercatDevice

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="ethercat", kind="cable"),)


def warm() -> None:
    """Do nothing: nothing is slow here."""


def create() -> EthercatDevice:
    """Return a fresh segment."""
    return EthercatDevice()
