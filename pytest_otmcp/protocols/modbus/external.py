"""A real Modbus device in the place of the mock."""

from __future__ import annotations

from ..external import DEVICE, ExternalDevice

__all__ = ["EXTERNAL"]

EXTERNAL = ExternalDevice(
    option=DEVICE,
    scheme="tcp",
    default_port=502,
    noun="Modbus device",
    implementation="pytest_otmcp.plant.field_modbus:ModbusFieldDevice",
)
