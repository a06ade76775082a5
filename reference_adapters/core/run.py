"""Runs an adapter server over stdio or streamable HTTP, as ``MCP_TRANSPORT`` says."""

from __future__ import annotations

import asyncio
import logging
import sys

from .server import AdapterServer
from .settings import ConfigError, Environment
from .stdio import serve_stdio

__all__ = ["serve"]

_TRANSPORTS = ("stdio", "streamable-http")


def serve(server: AdapterServer) -> int:
    """Serve until the client is gone; returns the exit code."""
    environment = Environment()
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(name)s: %(levelname)s: %(message)s")
    try:
        transport = environment.text("MCP_TRANSPORT", "stdio")
        if transport not in _TRANSPORTS:
            raise ConfigError(f"MCP_TRANSPORT: expected {' or '.join(_TRANSPORTS)}, found {transport!r}")
        port = environment.whole("MCP_HTTP_PORT", 8000, 0, 65535)
    except ConfigError as error:
        print(f"configuration: {error}", file=sys.stderr)
        return 2
    mode = "ENABLED" if server.writes_enabled else "disabled"
    print(f"{server.name}: {server.endpoint}, writes {mode}", file=sys.stderr)
    if transport == "stdio":
        asyncio.run(serve_stdio(server.mcp))
    else:
        import uvicorn

        # Loopback only: whoever wants the network puts an authenticating proxy in front.
        app = server.mcp.streamable_http_app(host="127.0.0.1")
        uvicorn.run(app, host="127.0.0.1", port=port, log_level="warning")
    return 0
