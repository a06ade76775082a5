"""The Modbus TCP adapter: 17 tools over one connection.

Environment: ``MODBUS_HOST``, ``MODBUS_PORT`` (502), ``MODBUS_UNIT_ID`` (1), ``MODBUS_TIMEOUT_S`` (1, per exchange),
``MODBUS_DEADLINE_S`` (3, per call), ``MODBUS_WRITES_ENABLED`` (no), ``MODBUS_TAG_MAP`` (a JSON file, see ``tags``).
"""

from __future__ import annotations

from .adapter import build

__all__ = ["build"]
