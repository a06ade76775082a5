"""A real OPC UA server in the place of the mock."""

from __future__ import annotations

import re
from urllib.parse import unquote

from ..external import DEVICE, ExternalDevice

__all__ = ["EXTERNAL"]

_NODE_ID = re.compile(r"(?:ns=(\d{1,5});)?(?:i=(\d{1,10})|s=.+)")
"""A numeric or a string identifier (OPC 10000-6, 5.3.1.10); what a URL cannot have in it is written as %XX."""


def _is_node(text: str) -> bool:
    found = _NODE_ID.fullmatch(unquote(text))
    return found is not None and int(found[1] or 0) <= 0xFFFF and int(found[2] or 0) <= 0xFFFF_FFFF


EXTERNAL = ExternalDevice(
    option=DEVICE,
    scheme="opc.tcp",
    default_port=4840,
    noun="OPC UA server",
    implementation="pytest_otmcp.plant.field_opcua:OpcUaFieldDevice",
    is_place=_is_node,
)
