"""The construction of the S7comm adapter from its settings."""

from __future__ import annotations

from ..core import AdapterServer, Environment
from .link import Link
from .tags import Tag
from .tools import Tools

__all__ = ["build"]


def build() -> AdapterServer:
    """Build the adapter that the environment configures.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    host = environment.text("S7_HOST", "127.0.0.1")
    port = environment.whole("S7_PORT", 102, 1, 65535)
    rack = environment.whole("S7_RACK", 0, 0, 7)
    slot = environment.whole("S7_SLOT", 1, 0, 31)
    tags = environment.entries("S7_TAG_MAP", Tag)
    link = Link(host, port, rack, slot, environment.seconds("S7_TIMEOUT_S", 1.0))
    server = AdapterServer(
        name="s7-reference",
        version="0.1.0",
        protocol="s7comm",
        endpoint=f"s7://{f'[{host}]' if ':' in host else host}:{port}/{rack}/{slot}",
        writes_enabled=environment.writes_enabled("S7_WRITES_ENABLED"),
        switch="S7_WRITES_ENABLED",
        deadline_s=environment.seconds("S7_DEADLINE_S", 3.0),
        close=link.close,
    )
    server.add(Tools(link, tags=tags, control_enabled=environment.writes_enabled("S7_CONTROL_ENABLED")))
    return server
