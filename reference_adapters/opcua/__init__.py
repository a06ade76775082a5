"""The OPC UA adapter: 7 tools over one session.

Environment: ``OPCUA_URL`` (opc.tcp://127.0.0.1:4840), ``OPCUA_TIMEOUT_S`` (2, per service call), ``OPCUA_DEADLINE_S``
(4, per tool call), ``OPCUA_WRITES_ENABLED`` (no), ``OPCUA_USERNAME``, ``OPCUA_PASSWORD``; for a secure channel see ``security``.
"""

from __future__ import annotations

from .adapter import build

__all__ = ["build"]
