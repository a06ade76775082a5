"""A tool that does nothing on the adapters' own skeleton: what every adapter call costs before its protocol begins."""

from __future__ import annotations

import gc
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


def build() -> AdapterServer:
    """The server with its one tool."""
    server = AdapterServer(
        name="null",
        version="0",
        protocol="none",
        endpoint="none://",
        writes_enabled=False,
        switch="NULL_WRITES_ENABLED",
        deadline_s=3.0,
        close=_close,
    )

    @server.tool("none.nothing")
    async def null(call: Call, arguments: Nothing) -> Done:
        """Do nothing."""
        return {"ok": True}

    return server


if __name__ == "__main__":
    server = build()
    # As the adapters do once they are built, so that the collector costs both the same.
    gc.freeze()
    sys.exit(serve(server))
