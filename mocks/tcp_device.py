"""The base class of devices that serve connections on one TCP port."""

from __future__ import annotations

import asyncio
import socket
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path

from .device import Device
from .endpoint import OpenEndpoint
from .network import Network

__all__ = ["TcpDevice"]


class TcpDevice(Device):
    """A device with one endpoint, which has the name of its protocol.

    Attributes:
        network: the way between the device and its clients.
    """

    def __init__(self) -> None:
        super().__init__()
        self.network = Network(self.journal)
        self._server: asyncio.Server | None = None

    @abstractmethod
    def connection(self) -> asyncio.Protocol:
        """Return what serves a new connection."""

    @property
    def dead_connections(self) -> int:
        return self.network.dead

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        listener = endpoints[self.protocol]
        assert isinstance(listener, socket.socket)
        factory = self.network.protocol(self.connection)
        self._server = await asyncio.get_running_loop().create_server(factory, sock=listener, backlog=128)

    def secure(self, folder: Path) -> None:
        self.network.secure(folder)

    async def aclose(self) -> None:
        if self._server is not None:
            self._server.close()
        self.network.close()
