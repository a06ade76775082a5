"""A real BACnet/IP device in the place of the mock."""

from __future__ import annotations

import re

from ..external import DEVICE, ExternalDevice

__all__ = ["EXTERNAL"]

EXTERNAL = ExternalDevice(
    option=DEVICE,
    scheme="udp",
    default_port=47808,
    noun="BACnet/IP device",
    implementation="pytest_otmcp.plant.field_bacnet:BacnetFieldDevice",
    is_place=lambda place: re.fullmatch(r"[0-9]{1,7}(/[0-9]{1,7})?", place) is not None,
)
