"""The MQTT and Sparkplug B adapter: 17 tools over one connection.

Environment: ``MQTT_URL`` (mqtt://127.0.0.1:1883), ``MQTT_VERSION`` (5, or 3.1.1), ``MQTT_CLIENT_ID`` (otmcp-adapter), ``MQTT_USERNAME``,
``MQTT_PASSWORD``, ``MQTT_TIMEOUT_S`` (2, per exchange), ``MQTT_DEADLINE_S`` (4, per call), ``MQTT_WRITES_ENABLED`` (no),
``SPARKPLUG_GROUP_ID`` (factory), ``SPARKPLUG_EDGE_NODE_ID`` (otmcp-adapter). With a URL ``mqtts://`` also ``MQTT_TLS_CA``, ``MQTT_TLS_CERT``, ``MQTT_TLS_KEY`` (see ``core.tls``).
"""

from __future__ import annotations

from .adapter import build

__all__ = ["build"]
