"""The endpoints of a device: what adapters connect to, send datagrams to, or open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

__all__ = ["Endpoint", "first_port"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoint:
    """One endpoint of a device. Its address stays the same while the device is stopped and started.

    Attributes:
        name: unique within the device, in the protocol's words; not ``http``, because ``{http_port}`` in a subject file is a port
            of the adapter.
        kind: a TCP port, a UDP port, or a pseudo terminal in the place of a serial line.
        host, port: of a port; empty and 0 for a pseudo terminal.
        path: of a pseudo terminal; empty for a port.
    """

    name: str
    kind: Literal["tcp", "udp", "pty"]
    host: str = ""
    port: int = 0
    path: str = ""


def first_port(endpoints: Mapping[str, Endpoint]) -> Endpoint | None:
    """Return the first endpoint that is a TCP or UDP port; None if there is none."""
    return next((endpoint for endpoint in endpoints.values() if endpoint.kind != "pty"), None)
