"""Relays over HTTP on this machine, each at an address of its own, for whoever has the key (MCP basic/transports, Streamable HTTP)."""

from __future__ import annotations

import hmac
import json
import secrets
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from ..session.loopback import HOST, serving
from .relay import Relay

__all__ = ["Served", "serve"]

_LARGEST = 4 << 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Served:
    """Relays that are served.

    Attributes:
        urls: protocol to address.
        token: sent as a bearer token.
    """

    urls: Mapping[str, str]
    token: str


@asynccontextmanager
async def serve(relays: Mapping[str, Relay]) -> AsyncIterator[Served]:
    """Serve relays as long as the block lasts.

    Args:
        relays: by protocol.
    """
    token = secrets.token_urlsafe(24)
    with socket.socket() as at:
        at.bind((HOST, 0))
        # Whoever is told the address may connect before the server runs.
        at.listen()
        host = f"{HOST}:{at.getsockname()[1]}"

        async def answer(request: Request) -> Response:
            given = request.headers.get("authorization", "").encode()
            if request.headers.get("host") != host or "origin" in request.headers:
                return Response(status_code=403)
            if not hmac.compare_digest(given, f"Bearer {token}".encode()):
                return Response(status_code=401)
            relay = relays.get(request.path_params["protocol"])
            if relay is None:
                return Response(status_code=404)
            body = bytearray()
            async for part in request.stream():
                body += part
                if len(body) > _LARGEST:
                    return Response(status_code=413)
            try:
                message = json.loads(body)
            except (ValueError, RecursionError):
                return Response(status_code=400)
            said = await relay.answer(message) if isinstance(message, dict) else None
            if said is None:
                return Response(status_code=202)
            return Response(json.dumps(said), media_type="application/json")

        application = Starlette(routes=[Route("/{protocol}/mcp", answer, methods=["POST"])])
        async with serving(application, at, name="otmcp-relays"):
            yield Served(urls={key: f"http://{host}/{key}/mcp" for key in relays}, token=token)
