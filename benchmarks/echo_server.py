"""The floor: a server that reads a JSON line and writes one, with no SDK. Two processes and two pipes cannot do less."""

from __future__ import annotations

import json
import sys


def main() -> None:
    """Answer every request that has an id with the same small result until standard input ends."""
    source, sink = sys.stdin.buffer, sys.stdout.buffer
    while line := source.readline():
        request = json.loads(line)
        if "id" in request:
            answer = {
                "jsonrpc": "2.0",
                "id": request["id"],
                "result": {"content": [], "structuredContent": {"ok": True}},
            }
            sink.write(json.dumps(answer).encode() + b"\n")
            sink.flush()


if __name__ == "__main__":
    main()
