"""The construction of the MQTT and Sparkplug B adapter from its settings."""

from __future__ import annotations

import re
from collections.abc import Callable
from urllib.parse import urlsplit

from ..core import AdapterServer, ConfigError, Environment, client_context
from .connection import VERSIONS, Endpoint
from .edge_node import EdgeNode
from .link import Link
from .sparkplug_tools import SparkplugTools
from .tools import Tools

__all__ = ["build"]

_LEVEL = re.compile(r"[^/+#\x00-\x1f\x7f]+")


def build(group: Callable[[Tools], object] | None = None) -> AdapterServer:
    """Build the adapter that the environment configures.

    Args:
        group: makes the object whose methods are the adapter's tools; None for the tools as they are, and those of Sparkplug B.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    endpoint = _endpoint(environment)
    may_write = environment.writes_enabled("MQTT_WRITES_ENABLED")
    node = EdgeNode(
        _identifier(environment, "SPARKPLUG_GROUP_ID", "factory"),
        _identifier(environment, "SPARKPLUG_EDGE_NODE_ID", "otmcp-adapter"),
    )
    link = Link(endpoint, node, may_write=may_write)
    server = AdapterServer(
        name="mqtt-reference",
        version="0.1.0",
        protocol="mqtt",
        endpoint=endpoint.uri,
        writes_enabled=may_write,
        switch="MQTT_WRITES_ENABLED",
        deadline_s=environment.seconds("MQTT_DEADLINE_S", 4.0),
        close=link.close,
    )
    if group is not None:
        server.add(group(Tools(link)))
        return server
    server.add(Tools(link))
    server.add(SparkplugTools(link), protocol="sparkplug-b")
    return server


def _endpoint(environment: Environment) -> Endpoint:
    expected = ConfigError("MQTT_URL: expected mqtt://host:port or mqtts://host:port")
    try:
        parts = urlsplit(environment.text("MQTT_URL", "mqtt://127.0.0.1:1883"))
        port = parts.port
    except ValueError:
        raise expected from None
    if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname or parts.path.strip("/") or parts.query:
        raise expected
    if parts.username is not None:
        raise ConfigError("MQTT_URL: user name and password belong into MQTT_USERNAME and MQTT_PASSWORD")
    secure = parts.scheme == "mqtts"
    tls = client_context(environment, "MQTT", always=secure)
    if tls is not None and not secure:
        raise ConfigError("MQTT_URL: expected mqtts://host:port, because there are settings of TLS")
    return Endpoint(
        host=parts.hostname,
        port=port or (8883 if secure else 1883),
        tls=tls,
        version=_version(environment),
        client_id=environment.text("MQTT_CLIENT_ID", "otmcp-adapter"),
        username=environment.optional("MQTT_USERNAME"),
        password=environment.optional("MQTT_PASSWORD"),
        timeout_s=environment.seconds("MQTT_TIMEOUT_S", 2.0),
    )


def _version(environment: Environment) -> str:
    text = environment.text("MQTT_VERSION", "5")
    if text not in VERSIONS:
        raise ConfigError(f"MQTT_VERSION: expected {' or '.join(VERSIONS)}, found {text!r}")
    return text


def _identifier(environment: Environment, name: str, default: str) -> str:
    text = environment.text(name, default)
    if not _LEVEL.fullmatch(text):
        raise ConfigError(f"{name}: expected one level of a topic, without / + #, found {text!r}")
    return text
