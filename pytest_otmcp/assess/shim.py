"""An MCP server on standard streams that hands each message on to a relay, for hosts that start what an ``mcp.json`` names.

``OTMCP_RELAY`` is the relay's address and ``OTMCP_RELAY_TOKEN`` the key to it.
"""

from __future__ import annotations

import os
import sys
import threading
import urllib.request

__all__ = ["main"]


def main() -> None:
    """Copy messages until standard input ends."""
    url, token = os.environ["OTMCP_RELAY"], os.environ["OTMCP_RELAY_TOKEN"]
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    writing = threading.Lock()

    def hand_on(line: bytes) -> None:
        asked = urllib.request.Request(url, line, headers)  # noqa: S310  (the kit's own address)
        with opener.open(asked) as answer:
            said = answer.read()
        if said:
            with writing:
                sys.stdout.buffer.write(said + b"\n")
                sys.stdout.buffer.flush()

    # A host may have several calls under way.
    for line in sys.stdin.buffer:
        if line.strip():
            threading.Thread(target=hand_on, args=(line,)).start()


if __name__ == "__main__":
    main()
