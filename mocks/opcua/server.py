"""asyncua's server, bent in three places: it accepts on a socket that is given to it, its client sessions are ours, and
connections are counted."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Any

from asyncua import Server
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession

__all__ = ["PlantServer"]

SessionFactory = Callable[..., InternalSession]


class _Internal(InternalServer):  # type: ignore[misc]
    """Hands out sessions made by ``session_factory`` to clients from outside."""

    session_factory: SessionFactory | None = None

    def create_session(self, name: str, user: Any = None, external: bool = False) -> InternalSession:
        if not external or self.session_factory is None:
            return super().create_session(name, user=user, external=external)
        return self.session_factory(self, self.aspace, self.subscription_service, name, user=user, external=True)


class PlantServer(Server):  # type: ignore[misc]
    """A server without security that serves a given listener."""

    def __init__(self) -> None:
        super().__init__(iserver=_Internal())
        self._listener: asyncio.Server | None = None
        self.set_server_name("OT-MCP mock plant")

    async def listen(
        self, listener: socket.socket, session_factory: SessionFactory, on_connection: Callable[[bool], None]
    ) -> None:
        """Accept connections on ``listener``.

        Args:
            session_factory: makes the sessions of clients.
            on_connection: called with True for a new connection and False for a lost one.
        """
        host, port = listener.getsockname()[:2]
        self.set_endpoint(f"opc.tcp://{host}:{port}")
        self.iserver.session_factory = session_factory
        await self._setup_server_nodes()
        await self.iserver.start()
        self.bserver = BinaryServer(self.iserver, host, port, self.limits)
        self.bserver.set_policies(self._policies)

        class Counted(OPCUAProtocol):  # type: ignore[misc]
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                on_connection(True)
                super().connection_made(transport)

            def connection_lost(self, ex: BaseException | None) -> None:
                on_connection(False)
                super().connection_lost(ex)

        def protocol() -> OPCUAProtocol:
            server = self.bserver
            return Counted(
                iserver=server.iserver,
                policies=server._policies,
                clients=server.clients,
                closing_tasks=server.closing_tasks,
                limits=server.limits,
            )

        self._listener = await asyncio.get_running_loop().create_server(protocol, sock=listener)
