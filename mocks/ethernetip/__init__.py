"""A Logix controller on EtherNet/IP: strict server of CIP explicit messages, tags, 1 Hz dynamics, faults on demand."""

from __future__ import annotations

from ..endpoint import Endpoint
from .device import EthernetIpDevice

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="ethernetip", kind="tcp"),)


def warm() -> None:
    """Do nothing: nothing is slow here."""


def create() -> EthernetIpDevice:
    """Return a fresh controller in slot 0 of its chassis."""
    return EthernetIpDevice()
