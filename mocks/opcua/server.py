"""asyncua's server with two changes: it accepts connections on a given socket, and its clients get the sessions and
connections of this package."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

from asyncua import Server, ua
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.binary_server_asyncio import BinaryServer
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession

from .exchange import current
from .processor import PlantProtocol
from .session import PlantSession
from .state import DeviceState

__all__ = ["PlantServer"]

_APPLICATION = "urn:otmcp:mock"


class _Internal(InternalServer):  # type: ignore[misc]
    """The internal server, which creates a device's sessions for clients from outside."""

    session_type: type[PlantSession] | None = None

    def create_session(self, name: str, user: Any = None, external: bool = False) -> InternalSession:
        if not external or self.session_type is None:
            return super().create_session(name, user=user, external=external)
        return self.session_type(self, self.aspace, self.subscription_service, name, user=user, external=True)


class _Users:
    """Those whom the device lets in (``asyncua.server.user_managers``)."""

    def __init__(self, owner: DeviceState) -> None:
        self._owner = owner

    def get_user(
        self, _: InternalServer, username: Any = None, password: Any = None, certificate: Any = None
    ) -> User | None:
        """Return the user of a session that is being activated, None for one that does not get in."""
        accepted = self._owner.accounts.lets_in(current().connection, username, password)
        return User(role=UserRole.User) if accepted else None


class PlantServer(Server):  # type: ignore[misc]
    """A server that serves a given listener, without security unless it is told otherwise."""

    def __init__(self) -> None:
        super().__init__(iserver=_Internal())
        self._listener: asyncio.Server | None = None
        self.set_server_name("OT-MCP mock plant")
        self._application_uri = _APPLICATION
        self.product_uri = _APPLICATION
        # Nobody has a certificate here. Without an account any user name and password is as good as none: an adapter may have been told some.
        self.set_identity_tokens([ua.AnonymousIdentityToken, ua.UserNameIdentityToken])

    def secure(self, files: tuple[Any, Any], policies: list[ua.SecurityPolicyType]) -> None:
        """Present a certificate, with its key, at endpoints with these policies, as soon as they are offered."""
        self.iserver.certificate, self.iserver.private_key = files
        self.set_security_policy(policies)

    async def offer(self) -> None:
        """Offer endpoints for the present policies, and no others."""
        self._policies.clear()
        self.iserver.endpoints.clear()
        await self._setup_server_nodes()

    async def listen(self, listener: socket.socket, owner: DeviceState) -> None:
        """Accept connections on ``listener`` for a device."""

        class Session(PlantSession):
            device = owner

        host, port = listener.getsockname()[:2]
        self.set_endpoint(f"opc.tcp://{host}:{port}")
        self.iserver.session_type = Session
        self.iserver.user_manager = _Users(owner)
        await self.offer()
        await self.iserver.start()
        self.bserver = BinaryServer(self.iserver, host, port, self.limits)
        self.bserver.set_policies(self._policies)

        def protocol() -> PlantProtocol:
            server = self.bserver
            return PlantProtocol(
                device=owner,
                iserver=server.iserver,
                policies=server._policies,
                clients=server.clients,
                closing_tasks=server.closing_tasks,
                limits=server.limits,
            )

        self._listener = await asyncio.get_running_loop().create_server(owner.network.protocol(protocol), sock=listener)
