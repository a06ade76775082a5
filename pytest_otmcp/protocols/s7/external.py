"""A real S7 controller in the place of the mock."""

from __future__ import annotations

from ..external import DEVICE, ExternalDevice

__all__ = ["EXTERNAL"]

EXTERNAL = ExternalDevice(
    option=DEVICE,
    scheme="tcp",
    default_port=102,
    noun="S7 controller",
    implementation="pytest_otmcp.plant.field_s7:S7FieldDevice",
)
