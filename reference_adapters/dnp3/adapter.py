"""The construction of the DNP3 adapter from its settings."""

from __future__ import annotations

from ..core import AdapterServer, Environment, client_context
from .aliases import Alias
from .link import Link
from .shapes import LAST_ADDRESS
from .tools import Tools

__all__ = ["build"]


def build() -> AdapterServer:
    """Build the adapter that the environment configures.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    tls = client_context(environment, "DNP3")
    host = environment.text("DNP3_HOST", "127.0.0.1")
    # IANA's registry has a port for DNP3 over TLS (dnp-sec).
    port = environment.whole("DNP3_PORT", 20000 if tls is None else 19999, 1, 65535)
    outstation = environment.whole("DNP3_OUTSTATION_ADDRESS", 10, 0, LAST_ADDRESS)
    master = environment.whole("DNP3_MASTER_ADDRESS", 1, 0, LAST_ADDRESS)
    aliases = environment.entries("DNP3_ALIAS_MAP", Alias)
    writes_enabled = environment.writes_enabled("DNP3_WRITES_ENABLED")
    link = Link(
        host,
        port,
        master,
        environment.seconds("DNP3_TIMEOUT_S", 1.0),
        known={outstation, *(alias.outstation_address for alias in aliases.values())},
        clears_restart=writes_enabled,
        tls=tls,
    )
    server = AdapterServer(
        name="dnp3-reference",
        version="0.1.0",
        protocol="dnp3",
        endpoint=f"{'dnp3' if tls is None else 'dnp3+tls'}://{f'[{host}]' if ':' in host else host}:{port}/{outstation}",
        writes_enabled=writes_enabled,
        switch="DNP3_WRITES_ENABLED",
        deadline_s=environment.seconds("DNP3_DEADLINE_S", 3.0),
        close=link.close,
    )
    direct = environment.writes_enabled("DNP3_DIRECT_OPERATE_ENABLED")
    server.add(Tools(link, outstation=outstation, aliases=aliases, direct_operate=direct))
    return server
