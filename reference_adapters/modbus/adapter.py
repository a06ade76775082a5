"""The construction of the Modbus TCP adapter from its settings."""

from __future__ import annotations

from collections.abc import Callable

from ..core import AdapterServer, ConfigError, Environment, client_context
from .link import Link
from .shapes import is_unit
from .tags import Tag
from .tools import Tools

__all__ = ["build"]


def _as_they_are(tools: Tools) -> object:
    return tools


def build(group: Callable[[Tools], object] = _as_they_are) -> AdapterServer:
    """Build the adapter that the environment configures.

    Args:
        group: makes the object whose methods are the adapter's tools.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    tls = client_context(environment, "MODBUS")
    host = environment.text("MODBUS_HOST", "127.0.0.1")
    port = environment.whole("MODBUS_PORT", 502 if tls is None else 802, 1, 65535)
    unit = environment.whole("MODBUS_UNIT_ID", 1, 0, 255)
    if not is_unit(unit):
        raise ConfigError(f"MODBUS_UNIT_ID: expected 0 to 247 or 255, found {unit}")
    tags = environment.entries("MODBUS_TAG_MAP", Tag)
    link = Link(host, port, environment.seconds("MODBUS_TIMEOUT_S", 1.0), tls)
    server = AdapterServer(
        name="modbus-reference",
        version="0.1.0",
        protocol="modbus-tcp" if tls is None else "modbus-tls",
        endpoint=f"modbus+{'tcp' if tls is None else 'tls'}://{f'[{host}]' if ':' in host else host}:{port}",
        writes_enabled=environment.writes_enabled("MODBUS_WRITES_ENABLED"),
        switch="MODBUS_WRITES_ENABLED",
        deadline_s=environment.seconds("MODBUS_DEADLINE_S", 3.0),
        close=link.close,
    )
    server.add(group(Tools(link, default_unit=unit, tags=tags)))
    return server
