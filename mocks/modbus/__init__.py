"""A Modbus TCP device: strict server, plant image, 1 Hz dynamics, faults on demand."""

from __future__ import annotations

from ..endpoint import Endpoint
from .device import ModbusDevice

__all__ = ["ENDPOINTS", "create", "warm"]

ENDPOINTS = (Endpoint(name="modbus", kind="tcp"),)


def warm() -> None:
    """Do nothing: nothing is slow here."""


def create() -> ModbusDevice:
    """Return a fresh device with unit 1."""
    return ModbusDevice()
