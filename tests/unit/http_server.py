"""A server of streamable HTTP without an SDK: run as ``python http_server.py CONTENT-TYPE``, which is that of its answers to calls.

With ``endless`` after it, an answer to a call never ends; with ``kept``, connections stay, and an answer says the caller's port; with a
number after it, calls are answered when so many wait at the same time.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

CONTENT_TYPE, ENDLESS, KEPT = sys.argv[1], "endless" in sys.argv[2:], "kept" in sys.argv[2:]
TOGETHER = threading.Barrier(next((int(word) for word in sys.argv[2:] if word.isdecimal()), 1))


class Server(BaseHTTPRequestHandler):
    """It speaks MCP of the year 2025, and has one tool, ``ping``."""

    protocol_version = "HTTP/1.1" if KEPT else "HTTP/1.0"

    def do_POST(self) -> None:
        message = json.loads(self.rfile.read(int(self.headers["content-length"])))
        method, params = message.get("method"), message.get("params") or {}
        if message.get("method") == "server/discover":
            # As version 1 of the official SDK answers a request without a session.
            error = {"code": -32600, "message": "Bad Request: Missing session ID"}
            self.answer("server-error", None, status=400, error=error)
        elif "id" not in message:
            self.send_response(202)
            self.send_header("content-length", "0")
            self.end_headers()
        elif method == "initialize":
            info = {"name": "s", "version": "0"}
            said = {"protocolVersion": params["protocolVersion"], "capabilities": {"tools": {}}, "serverInfo": info}
            self.answer(message["id"], said)
        elif method == "tools/list":
            self.answer(message["id"], {"tools": [{"name": "ping", "inputSchema": {"type": "object"}}]})
        else:
            TOGETHER.wait()
            port = {"type": "text", "text": str(self.client_address[1])}
            self.answer(message["id"], {"content": [port] if KEPT else []}, CONTENT_TYPE, endless=ENDLESS)

    def answer(
        self,
        identifier: Any,
        result: Any,
        kind: str = "application/json",
        *,
        endless: bool = False,
        status: int = 200,
        error: object = None,
    ) -> None:
        said = {"result": result} if error is None else {"error": error}
        body = json.dumps({"jsonrpc": "2.0", "id": identifier, **said}).encode()
        self.send_response(status)
        self.send_header("content-type", kind)
        if not endless:
            self.send_header("content-length", str(len(body)))
        self.end_headers()
        while endless:
            self.wfile.write(b" " * 1_000_000)
        self.wfile.write(body)


ThreadingHTTPServer.request_queue_size = 1024
ThreadingHTTPServer(("127.0.0.1", int(os.environ["MCP_HTTP_PORT"])), Server).serve_forever()
