"""What the kit's certificate and account for adapters say of them: ``plant`` makes them, and checks look for them at the device."""

from __future__ import annotations

__all__ = ["CLIENT", "ROLE", "USER"]

CLIENT = "otmcp-adapter"
"""The common name."""
ROLE = "otmcp-operator"
"""The role (MODBUS/TCP Security)."""
USER = "otmcp-user"
"""The name of the account."""
