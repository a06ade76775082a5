"""The construction of the EtherNet/IP adapter from its settings."""

from __future__ import annotations

from ..core import AdapterServer, Environment, client_context
from .aliases import Alias
from .link import Link
from .tools import Tools

__all__ = ["build"]


def build() -> AdapterServer:
    """Build the adapter that the environment configures.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    tls = client_context(environment, "ETHERNETIP")
    host = environment.text("ETHERNETIP_HOST", "127.0.0.1")
    port = environment.whole("ETHERNETIP_PORT", 44818 if tls is None else 2221, 1, 65535)
    slot = environment.whole("ETHERNETIP_SLOT", 0, 0, 16)
    aliases = environment.entries("ETHERNETIP_ALIAS_MAP", Alias)
    link = Link(host, port, slot, environment.seconds("ETHERNETIP_TIMEOUT_S", 1.0), tls)
    server = AdapterServer(
        name="ethernetip-reference",
        version="0.1.0",
        protocol="ethernet-ip",
        endpoint=f"{'eip' if tls is None else 'eip+tls'}://{f'[{host}]' if ':' in host else host}:{port}/{slot}",
        writes_enabled=environment.writes_enabled("ETHERNETIP_WRITES_ENABLED"),
        switch="ETHERNETIP_WRITES_ENABLED",
        deadline_s=environment.seconds("ETHERNETIP_DEADLINE_S", 3.0),
        close=link.close,
    )
    server.add(Tools(link, aliases=aliases, control_enabled=environment.writes_enabled("ETHERNETIP_CONTROL_ENABLED")))
    return server
