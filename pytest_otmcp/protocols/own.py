"""The kit's own protocols, each the sub-package of that name, in the order of tables and figures."""

from __future__ import annotations

__all__ = ["OWN"]

OWN = ("modbus", "mqtt", "opcua", "s7", "bacnet", "ethernetip", "dnp3", "profibus", "ethercat", "profinet")
