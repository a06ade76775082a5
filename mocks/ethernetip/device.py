"""The server of EtherNet/IP with journal and fault plan: sessions, CIP connections, explicit messages.

It is not a library's server, because a reference must be strict, and because what reached it has to be told in full.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from ..endpoint import OpenEndpoint
from ..tcp_device import TcpDevice
from .controller import Controller
from .faults import FaultPlan
from .link import ClientLink
from .pokes import CONNECTION_LIMIT, checked, poke, restless_bits

__all__ = ["EthernetIpDevice"]


class EthernetIpDevice(TcpDevice):
    """A controller in slot 0, with its own EtherNet/IP port."""

    protocol = "ethernetip"

    def __init__(self) -> None:
        super().__init__()
        self._controller = Controller(journal=self.journal)

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        await super().serve(endpoints)
        listener = endpoints[self.protocol]
        assert isinstance(listener, socket.socket)
        self._controller.address = listener.getsockname()[:2]

    def connection(self) -> asyncio.Protocol:
        """Return what serves a new client."""
        return ClientLink(self, self._controller)

    def image(self) -> dict[str, Any]:
        """Return what :meth:`.plant.Plant.image` returns, and how many ``sessions`` and CIP ``connections`` are open, and how many
        connections were ``forgotten`` by their clients; with bits that turn by themselves also ``restless``."""
        controller = self._controller
        image = controller.plant.image() | {
            "sessions": len(controller.sessions),
            "connections": len(controller.connections.open),
            "forgotten": controller.connections.forgotten,
        }
        return image | ({"restless": [asdict(bits) for bits in controller.restless]} if controller.restless else {})

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Change the controller past the protocol: see :mod:`.pokes`, and :mod:`..network` for ``{"network": …}``."""
        controller = self._controller
        if self.network.poke(params):
            return
        if "restless" in params:
            controller.restless = restless_bits(controller.plant, params["restless"])
        elif "connection_limit" in params:
            controller.plant.connection_limit = checked(CONNECTION_LIMIT, "connection_limit", params)
        elif "connections" in params:
            if params["connections"] != "forget":
                raise ValueError(f"connections: expected 'forget', found {params['connections']!r}")
            controller.connections.open.clear()
        else:
            poke(controller.plant, params)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self._controller.faults = self._controller.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self._controller.reset()
        self.network.restored()

    async def tick(self) -> None:
        self._controller.plant.tick()
