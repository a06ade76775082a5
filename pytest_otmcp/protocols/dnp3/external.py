"""A real DNP3 outstation in the place of the mock."""

from __future__ import annotations

from ..external import DEVICE, ExternalDevice

__all__ = ["EXTERNAL", "LAST_ADDRESS"]

LAST_ADDRESS = 0xFFEF
"""Addresses behind it are reserved, or those of every outstation (IEEE 1815, clause 9)."""


def _is_place(text: str) -> bool:
    addresses = text.split("/")
    return len(addresses) <= 2 and all(one.isdecimal() and int(one) <= LAST_ADDRESS for one in addresses)


EXTERNAL = ExternalDevice(
    option=DEVICE,
    scheme="tcp",
    default_port=20000,
    noun="DNP3 outstation",
    implementation="pytest_otmcp.plant.field_dnp3:Dnp3FieldDevice",
    is_place=_is_place,
)
