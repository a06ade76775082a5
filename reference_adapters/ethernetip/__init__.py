"""The EtherNet/IP adapter: 17 tools for the tags of a Logix controller, over one CIP connection.

Environment: ``ETHERNETIP_HOST``, ``ETHERNETIP_PORT`` (44818), ``ETHERNETIP_SLOT`` (0, of the controller), ``ETHERNETIP_TIMEOUT_S`` (1, per
exchange), ``ETHERNETIP_DEADLINE_S`` (3, per call), ``ETHERNETIP_WRITES_ENABLED`` (no), ``ETHERNETIP_CONTROL_ENABLED`` (no; setting the
controller's clock needs both), ``ETHERNETIP_ALIAS_MAP`` (a JSON file, see ``aliases``), ``ETHERNETIP_TLS_CA``, ``ETHERNETIP_TLS_CERT``,
``ETHERNETIP_TLS_KEY`` (see ``core.tls``; with them the port is 2221 by default).
"""

from __future__ import annotations

from .adapter import build

__all__ = ["build"]
