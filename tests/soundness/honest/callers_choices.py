"""Honest adapters over HTTP that know their callers in another way."""

from __future__ import annotations

import os
import socket
from dataclasses import replace
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any

from pytest_otmcp.reference_adapters.core import AdapterServer, principal, run

from .choice import choices

if TYPE_CHECKING:
    from pytest_otmcp.subject import Adapter

__all__ = ["CHOICES"]

_MODBUS, modbus = choices("modbus")
_MQTT, mqtt = choices("mqtt")
_DNP3, dnp3 = choices("dnp3")

_EVERY = str(ip_address(0))


@modbus(
    "takes who has no good token for a viewer, whose writes are refused in an envelope",
    "nothing is done for such a caller; the status of HTTP is for clients, which get another token then",
    checked_warnings=(("MCP-011", "other_status"),),
)
def refuses_in_answers(server: AdapterServer) -> None:
    verify, genuine = principal.Tokens.verify_token, principal.of_token

    async def verify_token(self: Any, token: str) -> Any:
        from mcp.server.auth.provider import AccessToken

        return await verify(self, token) or AccessToken(
            token=token, client_id="", scopes=["ot:read"], resource=self._resource
        )

    def of_token() -> principal.Principal:
        from mcp.server.auth.middleware.auth_context import get_access_token

        token = get_access_token()
        if token is None or token.subject is None:
            return principal.Principal("unknown", "viewer")
        return genuine()

    principal.Tokens.verify_token = verify_token  # type: ignore[method-assign]
    principal.of_token = of_token


def _writers_alone(adapter: Adapter) -> Adapter:
    assert adapter.tokens is not None
    scopes = replace(adapter.tokens.scopes, writes="plant", reads=None)
    return replace(adapter, tokens=replace(adapter.tokens, scopes=scopes))


@mqtt("has one scope, with which a caller may do everything", "scopes are its author's", described=_writers_alone)
def one_scope(server: AdapterServer) -> None:
    principal._READ = "plant"
    principal._SCOPES["plant"] = "operator"


@dnp3(
    "listens at every address of the machine",
    "MCP, Streamable HTTP, Security: to listen on the loopback interface is a SHOULD",
    checked_warnings=(("MCP-011", "listens_everywhere"),),
)
def listens_everywhere(server: AdapterServer) -> None:
    run._LOOPBACK[_EVERY] = socket.AF_INET
    os.environ["MCP_HTTP_HOST"] = _EVERY


CHOICES = {**_MODBUS, **_MQTT, **_DNP3}
