"""What is outside of a run, and must not be reached from inside: a "plant" that counts what comes."""

from __future__ import annotations

import os
import secrets
import socket
import tempfile
import threading
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

_BYTES = 65536
_PATIENCE_S = 60


class Outside:
    """Servers of the test's own process: TCP, UDP, and Unix sockets with an abstract name, with a path below ``/tmp``, and with
    two elsewhere, of which one was renamed; and a pipe beside them.

    Attributes:
        came: what came by which of them.
    """

    def __init__(self, elsewhere: Path) -> None:
        self.came: dict[str, int] = {}
        self._last = secrets.token_bytes(16)
        self._served = threading.Semaphore(0)
        self._kept = ExitStack()
        directory = self._kept.enter_context(tempfile.TemporaryDirectory(prefix="outside-"))
        self.name = f"outside-{secrets.token_hex(8)}"
        self.paths = {
            "path": f"{directory}/socket",
            "home": str(elsewhere / f"{self.name}.socket"),
            "renamed": str(elsewhere / f"{self.name}.renamed"),
        }
        self.pipe = str(elsewhere / f"{self.name}.pipe")
        os.mkfifo(self.pipe)
        self._pipe = os.open(self.pipe, os.O_RDWR | os.O_NONBLOCK)
        self._kept.callback(os.unlink, self.pipe)
        self._kept.callback(os.close, self._pipe)
        self._kept.callback(lambda: [os.unlink(path) for path in self.paths.values() if os.path.exists(path)])
        self.tcp = self._serve("tcp", socket.create_server(("127.0.0.1", 0)))
        for kind, address in (("abstract", f"\0{self.name}"), *self.paths.items()):
            server = socket.socket(socket.AF_UNIX)
            server.bind(f"{address}.before" if kind == "renamed" else address)
            if kind == "renamed":
                # The kernel goes on telling the name that it had first (/proc/net/unix).
                os.rename(f"{address}.before", address)
            server.listen()
            self._serve(kind, server)
        self.udp = self._kept.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        self.udp.bind(("127.0.0.1", 0))
        threading.Thread(target=self._receive, args=(self.udp,), daemon=True).start()

    def _serve(self, kind: str, server: socket.socket) -> socket.socket:
        self._kept.enter_context(server)
        threading.Thread(target=self._accept, args=(kind, server), daemon=True).start()
        return server

    def _accept(self, kind: str, server: socket.socket) -> None:
        with suppress(OSError):
            while True:
                connection, _ = server.accept()
                with connection, suppress(OSError):
                    self._note(kind, connection.recv(_BYTES))

    def _receive(self, server: socket.socket) -> None:
        with suppress(OSError):
            while data := server.recv(_BYTES):
                self._note("udp", data)

    def _note(self, kind: str, data: bytes) -> None:
        if data == self._last:
            self._served.release()
        else:
            self.came[kind] = self.came.get(kind, 0) + max(1, len(data))

    def reached(self) -> set[str]:
        """Return which servers something has come to. Each serves what this sends, and before that everything that came earlier."""
        streams = (
            (socket.AF_INET, self.tcp.getsockname()),
            (socket.AF_UNIX, f"\0{self.name}"),
            *((socket.AF_UNIX, path) for path in self.paths.values()),
        )
        for family, address in streams:
            with socket.socket(family) as client:
                client.connect(address)
                client.sendall(self._last)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.sendto(self._last, self.udp.getsockname())
        for _ in range(len(streams) + 1):
            assert self._served.acquire(timeout=_PATIENCE_S)
        with suppress(BlockingIOError):
            self._note("pipe", os.read(self._pipe, _BYTES))
        return set(self.came)

    def addresses(self) -> dict[str, Any]:
        """Return where everything is."""
        return {
            "tcp": self.tcp.getsockname(),
            "udp": self.udp.getsockname(),
            "abstract": self.name,
            **self.paths,
            "pipe": self.pipe,
            "process": os.getpid(),
        }

    def close(self) -> None:
        """End all servers."""
        for server in (self.tcp, self.udp):
            with suppress(OSError):
                server.shutdown(socket.SHUT_RDWR)
        self._kept.close()
