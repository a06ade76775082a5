"""The run of an adapter server over stdio or streamable HTTP.

Environment: ``MCP_TRANSPORT`` (``stdio`` or ``streamable-http``), ``MCP_HTTP_HOST`` (127.0.0.1) and ``MCP_HTTP_PORT``
(8000; 0 takes a free one).
"""

from __future__ import annotations

import asyncio
import gc
import logging
import socket
import sys

from .server import AdapterServer
from .settings import ConfigError, Environment
from .stdio import serve_stdio

__all__ = ["serve"]

_TRANSPORTS = ("stdio", "streamable-http")
# The server has no authentication; for access from the network an authenticating proxy belongs in front of it.
_LOOPBACK = {"127.0.0.1": socket.AF_INET, "localhost": socket.AF_INET, "::1": socket.AF_INET6}


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
    except ConfigError as error:
        print(f"configuration: {error}", file=sys.stderr)
        return 2
    mode = "ENABLED" if server.writes_enabled else "disabled"
    print(f"{server.name}: {server.endpoint}, writes {mode}", file=sys.stderr, flush=True)
    # The objects built so far live until the end, and a call leaves almost no cyclic garbage: collecting it after every
    # other call costs more than it frees (measured: 45 of 1700 us of a read).
    gc.freeze()
    gc.set_threshold(20_000)
    if transport == "stdio":
        asyncio.run(serve_stdio(server.mcp))
        return 0
    return _serve_http(server, host, port)


def _serve_http(server: AdapterServer, host: str, port: int) -> int:
    import uvicorn

    with socket.socket(_LOOPBACK[host], socket.SOCK_STREAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, port))
        except OSError as error:
            print(f"MCP_HTTP_PORT: {port} cannot be used: {error.strerror}", file=sys.stderr)
            return 1
        shown = f"[{host}]" if ":" in host else host
        print(f"{server.name}: http://{shown}:{listener.getsockname()[1]}/mcp", file=sys.stderr, flush=True)
        app = server.mcp.streamable_http_app(host=host)
        uvicorn.Server(uvicorn.Config(app, log_level="warning")).run(sockets=[listener])
    return 0
