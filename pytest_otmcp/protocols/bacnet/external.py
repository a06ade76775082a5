"""A real BACnet/IP device in the place of the mock."""

from __future__ import annotations

from ..external import DEVICE, ExternalDevice

__all__ = ["EXTERNAL"]

EXTERNAL = ExternalDevice(
    option=DEVICE,
    scheme="udp",
    default_port=47808,
    noun="BACnet/IP device",
    implementation="pytest_otmcp.plant.field_bacnet:BacnetFieldDevice",
)
