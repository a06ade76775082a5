"""A tool that does nothing on the adapters' own skeleton: the cost of every adapter call before its protocol begins.

As ``python -m benchmarks.null_adapter EXCHANGE HOST PORT``, or with the path of a line, the tool makes one bare exchange: an adapter that checks
nothing, keeps no record and reports nothing. It is the control of the sum that adapters are compared with.
"""

from __future__ import annotations

import sys
from collections.abc import Awaitable, Callable

from typing_extensions import TypedDict

from reference_adapters.core import AdapterServer, Arguments, Call, tool
from reference_adapters.core.run import serve


class Nothing(Arguments):
    """No arguments."""


class Done(TypedDict):
    """That it was done."""

    ok: bool


Exchange = Callable[[], Awaitable[None]]


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


class NullTool:
    """The tool that does nothing."""

    @tool("none.nothing")
    async def null(self, call: Call, arguments: Nothing) -> Done:
        """Do nothing."""
        return {"ok": True}


class ControlTool:
    """The tool that makes one bare exchange.

    Args:
        connect: connects to the device and returns the exchange.
    """

    def __init__(self, connect: Callable[[], Awaitable[Exchange]]) -> None:
        self._connect = connect
        self._exchange: Exchange | None = None

    @tool("none.nothing")
    async def null(self, call: Call, arguments: Nothing) -> Done:
        """Exchange once."""
        if self._exchange is None:
            self._exchange = await self._connect()
        await self._exchange()
        return {"ok": True}


def build() -> AdapterServer:
    """Build the server whose tool does nothing."""
    server = _server()
    server.add(NullTool())
    return server


def build_control(name: str, *where: str) -> AdapterServer:
    """Build the server whose tool makes one exchange of this name."""
    from .raw_client import connect

    server = _server()
    server.add(ControlTool(lambda: connect(name, *where)))
    return server


if __name__ == "__main__":
    server = build_control(*sys.argv[1:]) if len(sys.argv) > 1 else build()
    sys.exit(serve(server))
