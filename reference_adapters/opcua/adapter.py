"""The construction of the OPC UA adapter from its settings."""

from __future__ import annotations

from urllib.parse import urlsplit

from ..core import AdapterServer, ConfigError, Environment
from .link import DEFAULT_PORT, Link
from .security import Security
from .tools import Tools

__all__ = ["build"]


def build() -> AdapterServer:
    """Build the adapter that the environment configures.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    url = environment.text("OPCUA_URL", f"opc.tcp://127.0.0.1:{DEFAULT_PORT}")
    endpoint = _endpoint(url)
    link = Link(
        url,
        environment.seconds("OPCUA_TIMEOUT_S", 2.0),
        environment.optional("OPCUA_USERNAME"),
        environment.optional("OPCUA_PASSWORD"),
        Security.of(environment, urlsplit(endpoint).hostname or ""),
    )
    server = AdapterServer(
        name="opcua-reference",
        version="0.1.0",
        protocol="opcua",
        endpoint=endpoint,
        writes_enabled=environment.writes_enabled("OPCUA_WRITES_ENABLED"),
        switch="OPCUA_WRITES_ENABLED",
        deadline_s=environment.seconds("OPCUA_DEADLINE_S", 4.0),
        close=link.close,
    )
    server.add(Tools(link))
    return server


def _endpoint(url: str) -> str:
    """Return the URL without credentials and with its port.

    Raises:
        ConfigError: the text is no URL of an OPC UA server.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port or DEFAULT_PORT
    except ValueError:
        host = None
    if not host or parts.scheme != "opc.tcp":
        raise ConfigError("OPCUA_URL: expected opc.tcp://host:port")
    return f"opc.tcp://{f'[{host}]' if ':' in host else host}:{port}"
