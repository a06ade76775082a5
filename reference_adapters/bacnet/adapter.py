"""The construction of the BACnet/IP adapter from its settings."""

from __future__ import annotations

from ..core import AdapterServer, ConfigError, Environment
from .aliases import Alias
from .link import Link
from .shapes import MINIMUM_ON_OFF
from .tools import Tools

__all__ = ["build"]


def build() -> AdapterServer:
    """Build the adapter that the environment configures.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    host = environment.text("BACNET_HOST", "127.0.0.1")
    port = environment.whole("BACNET_PORT", 47808, 1, 65535)
    priority = environment.whole("BACNET_PRIORITY", 8, 1, 16)
    if priority == MINIMUM_ON_OFF:
        raise ConfigError("BACNET_PRIORITY: 6 is reserved for minimum on and off times")
    aliases = environment.entries("BACNET_ALIAS_MAP", Alias)
    link = Link(host, port, environment.seconds("BACNET_TIMEOUT_S", 2.0))
    server = AdapterServer(
        name="bacnet-reference",
        version="0.1.0",
        protocol="bacnet-ip",
        endpoint=f"bacnet://{host}:{port}",
        writes_enabled=environment.writes_enabled("BACNET_WRITES_ENABLED"),
        switch="BACNET_WRITES_ENABLED",
        deadline_s=environment.seconds("BACNET_DEADLINE_S", 5.0),
        close=link.close,
    )
    configures = environment.writes_enabled("BACNET_CONFIGURATION_ENABLED")
    server.add(Tools(link, aliases=aliases, priority=priority, configures=configures))
    return server
