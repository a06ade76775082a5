"""Adapters that misbehave as processes: run as ``python rogue.py MODE``. No SDK is used, as an SDK would behave well.

Each mode answers ``initialize`` and ``tools/list`` like a legacy-era server unless that is where it misbehaves.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from typing import Any

ENVELOPE = {
    "success": True,
    "data": {"reachable": True},
    "error": None,
    "meta": {
        "schema": "otmcp/1.0",
        "protocol": "modbus-tcp",
        "operation": "modbus.ping",
        "endpoint": "modbus+tcp://127.0.0.1:1",
        "started_at": "2026-01-01T00:00:00.000Z",
        "latency_ms": 0.0,
        "attempts": 1,
        "request_id": "r",
        "source": "device",
        "connection": {"state": "connected", "generation": 1},
        "trace": {},
    },
}


def write(message: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


def result(identifier: Any, value: dict[str, Any]) -> None:
    write({"jsonrpc": "2.0", "id": identifier, "result": value})


def call(mode: str, identifier: Any) -> None:
    envelope = json.loads(json.dumps(ENVELOPE))
    answer = {"content": [{"type": "text", "text": json.dumps(envelope)}], "structuredContent": envelope}
    if mode == "wrong-id":
        result(identifier + 1000, answer)
    elif mode == "huge-reply":
        envelope["data"]["padding"] = "x" * 50_000_000
        result(identifier, answer)
    elif mode == "dies-in-call":
        print("fatal: out of spindle oil", file=sys.stderr)
        sys.stderr.flush()
        os._exit(7)
    elif mode == "hangs-in-call":
        time.sleep(3600)
    elif mode == "not-json":
        write_raw = '{"jsonrpc":"2.0","id":%d,"result":{"content":[],"structuredContent":{"success":NaN}}}'
        sys.stdout.write(write_raw % identifier + "\n")
        sys.stdout.flush()
    else:
        result(identifier, answer)


def serve(mode: str) -> None:
    tools = [{"name": "ping", "inputSchema": {"type": "object"}}]
    for line in sys.stdin:
        message = json.loads(line)
        method, identifier = message.get("method"), message.get("id")
        if method == "initialize":
            if mode == "dies-in-initialize":
                print("Traceback: no module named 'spindle'", file=sys.stderr)
                sys.exit(3)
            if mode == "hangs-in-initialize":
                time.sleep(3600)
            info = {"name": "rogue", "version": "0"}
            version = message["params"]["protocolVersion"]
            result(identifier, {"protocolVersion": version, "capabilities": {"tools": {}}, "serverInfo": info})
        elif method == "tools/list":
            result(identifier, {"tools": tools})
        elif method == "tools/call":
            call(mode, identifier)
        elif mode == "stops-at-discover" and method == "server/discover":
            time.sleep(3600)
        elif identifier is not None:
            write({"jsonrpc": "2.0", "id": identifier, "error": {"code": -32601, "message": "no such method"}})


def main() -> None:
    mode = sys.argv[1]
    if mode == "dead":
        print("spindle.conf: no such file", file=sys.stderr)
        sys.exit(1)
    if mode == "stdout-flood":
        while True:
            print("I am the spindle " * 10)
    if mode == "stderr-flood":
        for _ in range(40_000):
            print("debug: spindle at 12000 rpm, all is well " * 3, file=sys.stderr)
    if mode == "forks":
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(3600)"])
        print(f"child {child.pid}", file=sys.stderr, flush=True)
    serve(mode)
    if mode == "never-exits":
        while True:
            time.sleep(3600)


if __name__ == "__main__":
    main()
