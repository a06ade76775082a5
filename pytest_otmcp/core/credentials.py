"""What the kit's certificate for adapters says of them: ``plant.pki`` writes it, and checks look for it at the device."""

from __future__ import annotations

__all__ = ["CLIENT", "ROLE"]

CLIENT = "otmcp-adapter"
"""The common name."""
ROLE = "otmcp-operator"
"""The role (MODBUS/TCP Security)."""
