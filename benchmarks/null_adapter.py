"""A tool that does nothing on the adapters' own skeleton: what every adapter call costs before its protocol begins.

As ``python -m benchmarks.null_adapter EXCHANGE HOST PORT`` the tool makes one bare exchange: an adapter that checks
nothing, keeps no record and reports nothing. It is the control of the sum that adapters are held against.
"""

from __future__ import annotations

import sys

from typing_extensions import TypedDict

from reference_adapters.core import AdapterServer, Arguments, Call
from reference_adapters.core.run import serve


class Nothing(Arguments):
    """No arguments."""


class Done(TypedDict):
    """That it was done."""

    ok: bool


async def _close() -> None:
    return


def _server() -> AdapterServer:
    return AdapterServer(
        name="null",
        version="0",
        protocol="none",
        endpoint="none://",
        writes_enabled=False,
        switch="NULL_WRITES_ENABLED",
        deadline_s=3.0,
        close=_close,
    )


def build() -> AdapterServer:
    """The server with its one tool."""
    server = _server()

    @server.tool("none.nothing")
    async def null(call: Call, arguments: Nothing) -> Done:
        """Do nothing."""
        return {"ok": True}

    return server


def build_control(name: str, host: str, port: int) -> AdapterServer:
    """The server whose tool makes one exchange of this name."""
    from .raw_client import EXCHANGES, Exchange

    server = _server()
    connected: list[Exchange] = []

    @server.tool("none.nothing")
    async def null(call: Call, arguments: Nothing) -> Done:
        """Exchange once."""
        if not connected:
            connected.append(await EXCHANGES[name](host, port))
        await connected[0]()
        return {"ok": True}

    return server


if __name__ == "__main__":
    server = build_control(sys.argv[1], sys.argv[2], int(sys.argv[3])) if len(sys.argv) > 1 else build()
    sys.exit(serve(server))
