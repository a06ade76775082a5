"""The run of an adapter server over stdio or streamable HTTP.

Environment: ``MCP_TRANSPORT`` (``stdio`` or ``streamable-http``), ``MCP_HTTP_HOST`` (127.0.0.1), ``MCP_HTTP_PORT``
(8000; 0 takes a free one), and ``MCP_HTTP_ORIGINS``: the origins of web pages that may call, separated by commas, such as
``http://localhost:6274`` (none but the server's own). Who may call over HTTP is said in ``principal``; without that everybody on this machine may.
"""

from __future__ import annotations

import asyncio
import gc
import logging
import re
import socket
import sys

from .principal import Tokens
from .server import AdapterServer
from .settings import ConfigError, Environment
from .stdio import serve_stdio

__all__ = ["serve"]

_TRANSPORTS = ("stdio", "streamable-http")
# There is no TLS; for access from the network a proxy belongs in front of the server.
_LOOPBACK = {"127.0.0.1": socket.AF_INET, "localhost": socket.AF_INET, "::1": socket.AF_INET6}
_BACKLOG = 2048
_ORIGIN = re.compile(r"https?://[^\s/?#*@]+")


def serve(server: AdapterServer) -> int:
    """Serve until the client has gone and return the exit code."""
    environment = Environment()
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(name)s: %(levelname)s: %(message)s")
    try:
        transport = environment.text("MCP_TRANSPORT", "stdio")
        if transport not in _TRANSPORTS:
            raise ConfigError(f"MCP_TRANSPORT: expected {' or '.join(_TRANSPORTS)}, found {transport!r}")
        host = environment.text("MCP_HTTP_HOST", "127.0.0.1")
        if host not in _LOOPBACK:
            raise ConfigError(f"MCP_HTTP_HOST: expected one of {', '.join(_LOOPBACK)}, found {host!r}")
        port = environment.whole("MCP_HTTP_PORT", 8000, 0, 65535)
        origins = _origins(environment)
        over_http = transport != "stdio"
        tokens = Tokens.of(environment) if over_http else None
        server.ready(over_http=over_http, has_tokens=tokens is not None)
    except ConfigError as error:
        print(f"configuration: {error}", file=sys.stderr)
        return 2
    mode = "ENABLED" if server.writes_enabled else "disabled"
    print(f"{server.name}: {server.endpoint}, writes {mode}", file=sys.stderr, flush=True)
    # The objects built so far live until the end, and a call leaves almost no cyclic garbage: collecting it after every
    # other call costs more than it frees (measured: 45 of 1700 us of a read).
    gc.freeze()
    gc.set_threshold(20_000)
    try:
        if over_http:
            return _serve_http(server, host, port, origins, tokens)
        asyncio.run(serve_stdio(server.mcp))
        return 0
    finally:
        server.ended()


def _origins(environment: Environment) -> list[str]:
    """Return the origins that are named.

    Raises:
        ConfigError: one is not as browsers send them (RFC 6454, section 6.2).
    """
    origins = [one.strip() for one in environment.text("MCP_HTTP_ORIGINS", "").split(",") if one.strip()]
    for origin in origins:
        if not _ORIGIN.fullmatch(origin):
            raise ConfigError(f"MCP_HTTP_ORIGINS: expected origins such as http://localhost:6274, found {origin!r}")
    return origins


def _serve_http(server: AdapterServer, host: str, port: int, origins: list[str], tokens: Tokens | None) -> int:
    import uvicorn
    from mcp.server.transport_security import TransportSecuritySettings

    # asyncio sets TCP_NODELAY only on connections of a socket that says its protocol. Without, head and body of an answer
    # wait for each other (Nagle's algorithm and a delayed ACK, 40 ms a call).
    with socket.socket(_LOOPBACK[host], socket.SOCK_STREAM, socket.IPPROTO_TCP) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, port))
            # From here on connections are taken, and wait until the application has started: whoever reads the line below
            # may connect.
            listener.listen(_BACKLOG)
        except OSError as error:
            print(f"MCP_HTTP_PORT: {port} cannot be used: {error.strerror}", file=sys.stderr)
            return 1
        taken = listener.getsockname()[1]
        shown = f"[{host}]" if ":" in host else host
        print(f"{server.name}: http://{shown}:{taken}/mcp", file=sys.stderr, flush=True)
        # The SDK's own settings let every web page of this machine call, whatever its port.
        own = [f"http://{name}:{taken}" for name in ("127.0.0.1", "localhost", "[::1]")]
        security = TransportSecuritySettings(
            allowed_hosts=["127.0.0.1:*", "localhost:*", "[::1]:*"], allowed_origins=[*own, *origins]
        )
        # With settings and without a verifier the SDK would be open.
        auth = None if tokens is None else tokens.settings
        app = server.mcp.streamable_http_app(transport_security=security, auth=auth, token_verifier=tokens)
        uvicorn.Server(uvicorn.Config(app, log_level="warning", backlog=_BACKLOG)).run(sockets=[listener])
    return 0
