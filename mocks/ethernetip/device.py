"""The server of EtherNet/IP with journal and fault plan: sessions, CIP connections, explicit messages.

It is not a library's server, because a reference must be strict, and because what reached it has to be told in full.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from ..device import Device
from ..endpoint import OpenEndpoint
from ..network import Network
from .connections import Connections
from .faults import FaultPlan
from .link import ClientLink
from .plant import Plant
from .pokes import CONNECTION_LIMIT, Restless, checked, poke, restless_bits

__all__ = ["EthernetIpDevice"]


class EthernetIpDevice(Device):
    """A controller in slot 0, with its own EtherNet/IP port.

    Attributes:
        address: host and port on which it serves.
        links: number of TCP connections that have been opened.
        sessions: handles of the sessions that are registered.
    """

    protocol = "ethernetip"

    def __init__(self) -> None:
        super().__init__()
        self.plant = Plant()
        self.faults = FaultPlan([])
        self.restless: list[Restless] = []
        self.connections = Connections()
        self.network = Network(self.journal)
        self.address = ("127.0.0.1", 0)
        self.links = 0
        self.sessions: set[int] = set()
        self._server: asyncio.Server | None = None

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        listener = endpoints["ethernetip"]
        assert isinstance(listener, socket.socket)
        self.address = listener.getsockname()[:2]
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(
            self.network.protocol(lambda: ClientLink(self)), sock=listener, backlog=128
        )

    async def aclose(self) -> None:
        if self._server is not None:
            self._server.close()
        self.network.close()

    def image(self) -> dict[str, Any]:
        """Return what :meth:`.plant.Plant.image` returns, and how many ``sessions`` and CIP ``connections`` are open, and how many
        connections were ``forgotten`` by their clients; with bits that turn by themselves also ``restless``."""
        image = self.plant.image() | {
            "sessions": len(self.sessions),
            "connections": len(self.connections.open),
            "forgotten": self.connections.forgotten,
        }
        return image | ({"restless": [asdict(bits) for bits in self.restless]} if self.restless else {})

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Change the controller past the protocol: see :mod:`.pokes`, and :mod:`..network` for ``{"network": …}``."""
        if self.network.poke(params):
            return
        if "restless" in params:
            self.restless = restless_bits(self.plant, params["restless"])
        elif "connection_limit" in params:
            self.plant.connection_limit = checked(CONNECTION_LIMIT, "connection_limit", params)
        elif "connections" in params:
            if params["connections"] != "forget":
                raise ValueError(f"connections: expected 'forget', found {params['connections']!r}")
            self.connections.open.clear()
        else:
            poke(self.plant, params)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.faults = self.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.plant = Plant()
        self.faults = FaultPlan([])
        self.restless = []
        self.connections.forgotten = 0
        self.network.become("open")

    async def tick(self) -> None:
        self.plant.tick()
