"""The Modbus TCP adapter: 17 tools over one connection.

Environment: ``MODBUS_HOST``, ``MODBUS_PORT`` (502), ``MODBUS_UNIT_ID`` (1), ``MODBUS_TIMEOUT_S`` (1, per exchange),
``MODBUS_DEADLINE_S`` (3, per call), ``MODBUS_WRITES_ENABLED`` (no), ``MODBUS_TAG_MAP`` (a JSON file, see ``tags``),
``MODBUS_TLS_CA``, ``MODBUS_TLS_CERT``, ``MODBUS_TLS_KEY`` (see ``core.tls``; with them the port is 802 by default).
"""

from __future__ import annotations

from .adapter import build

__all__ = ["build"]
