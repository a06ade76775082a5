"""A Modbus TCP device: strict server, plant image, 1 Hz dynamics, faults on demand."""

from __future__ import annotations

from .device import ModbusDevice

__all__ = ["create", "warm"]


def warm() -> None:
    """Nothing is slow here."""


def create() -> ModbusDevice:
    """A fresh device with unit 1."""
    return ModbusDevice()
