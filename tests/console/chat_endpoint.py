"""An endpoint of the OpenAI-compatible chat interface that answers what a test has written down."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

__all__ = ["Scripted", "calling", "saying", "scripted"]


def saying(text: str) -> dict[str, Any]:
    """Return an answer in words."""
    return {"choices": [{"message": {"role": "assistant", "content": text}}]}


def calling(name: str, **arguments: object) -> dict[str, Any]:
    """Return an answer that calls a tool."""
    function = {"name": name, "arguments": json.dumps(arguments)}
    call = {"id": "call-1", "type": "function", "function": function}
    return {"choices": [{"message": {"role": "assistant", "content": None, "tool_calls": [call]}}]}


class Scripted:
    """Where the endpoint is, and what it was asked.

    Attributes:
        url: its base.
        asked: the requests.
        keys: the values of their Authorization.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.asked: list[dict[str, Any]] = []
        self.keys: list[str | None] = []


@contextmanager
def scripted(answers: Sequence[object], status: int = 200) -> Iterator[Scripted]:
    """Serve the answers one after the other, and the last one for ever."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            script.keys.append(self.headers["Authorization"])
            script.asked.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            body = json.dumps(answers[min(len(script.asked), len(answers)) - 1]).encode()
            self.send_response(status if self.path == "/v1/chat/completions" else 404)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        script = Scripted(f"http://127.0.0.1:{server.server_address[1]}/v1")
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield script
        server.shutdown()
