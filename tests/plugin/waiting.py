"""A Modbus adapter that waits in the middle of a call: ``python waiting.py TOOL NUMBER PORT``.

It is the reference adapter, but its call NUMBER of TOOL connects to PORT and goes on when that connection is closed.
"""

from __future__ import annotations

import asyncio
import sys
from dataclasses import replace
from typing import Any

from pytest_otmcp.reference_adapters.core.run import serve
from pytest_otmcp.reference_adapters.modbus import build


def main() -> None:
    """Serve until standard input closes."""
    name, number, port = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    server = build()
    tool = server._tools[name]
    calls = 0

    async def handler(call: Any, arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == number:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            await reader.read()
            writer.close()
        return await tool.handler(call, arguments)

    server._tools[name] = replace(tool, handler=handler)
    sys.exit(serve(server))


if __name__ == "__main__":
    main()
