"""An edge node as a device of its own: ``python -m pytest_otmcp.mocks sparkplug --broker mqtt://host:port``.

It has no clients, so no launcher has to keep an address. It prints one ready line with the broker's address and its own
control socket, and runs until standard input ends. Its journal holds the packets of its own connection, as the edge node
sees them.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import sys
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

from ..control import ControlServer
from ..control_socket import ControlSocket
from ..device import Device
from ..endpoint import OpenEndpoint
from ..journal import Direction
from ..mqtt.edge_node import CLIENT_ID, EdgeNode

__all__ = ["SparkplugSimulator", "broker_address", "run"]


def broker_address(url: str) -> tuple[str, int]:
    """Return host and port of ``mqtt://host[:port]``.

    Raises:
        ValueError: the URL is of another form.
    """
    parts = urlsplit(url)
    if parts.scheme != "mqtt" or not parts.hostname or parts.username or parts.path.strip("/"):
        raise ValueError(f"expected mqtt://host:port, found {url!r}")
    return parts.hostname, parts.port or 1883


class SparkplugSimulator(Device):
    """An edge node whose journal holds its own packets: ``out`` is what it sent to the broker."""

    protocol = "sparkplug"

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self._address = (host, port)
        self._edge_node = EdgeNode(self._observe)

    def _observe(self, direction: Direction, frame: bytes) -> None:
        self.journal.frame(frame, connection=1, direction=direction, origin="plant", client_id=CLIENT_ID)

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        """Connect to the broker. Clients never connect to an edge node: there are no endpoints."""
        await self._edge_node.start(self._dial)

    async def _dial(self) -> socket.socket:
        # A host may have several addresses, of which the broker listens at one.
        return await asyncio.to_thread(socket.create_connection, self._address)

    async def aclose(self) -> None:
        await self._edge_node.aclose()

    def image(self) -> dict[str, Any]:
        """Return the ``edge_node``; and ``points``: ``edge_node/<device>/<tag>`` to value."""
        return {"edge_node": self._edge_node.image(), "points": self._edge_node.points()}

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Make the node do something: ``{"edge_node": {…}}``, see ``mqtt.edge_node_pokes``."""
        if set(params) != {"edge_node"}:
            raise ValueError("a poke of an edge node is {'edge_node': {…}}; a command is published at its broker")
        await self._edge_node.poke(params["edge_node"])

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        if rules:
            raise ValueError("an edge node has no fault plan")
        return []

    async def reset(self) -> None:
        await self._edge_node.reset()

    async def tick(self) -> None:
        await self._edge_node.tick()


def run(host: str, port: int) -> int:
    """Serve until standard input ends or a signal arrives, and return the exit code.

    Raises:
        OSError: the broker cannot be reached or refuses.
    """
    asyncio.run(_run(host, port))
    return 0


async def _run(host: str, port: int) -> None:
    loop = asyncio.get_running_loop()
    ended = asyncio.Event()

    def read_input() -> None:
        if not os.read(0, 4096):
            ended.set()

    # Input that cannot be watched (a file, /dev/null) never ends; then a signal must end the program.
    with contextlib.suppress(PermissionError):
        loop.add_reader(0, read_input)
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    device = SparkplugSimulator(host, port)
    await device.serve({})
    control = ControlSocket()
    try:
        await ControlServer(device).start(control.listen())
        ready = {"event": "ready", "protocol": device.protocol, "host": host, "port": port}
        sys.stdout.write(json.dumps({**ready, "control": control.path, "pid": os.getpid()}) + "\n")
        sys.stdout.flush()
        await ended.wait()
        await device.aclose()
    finally:
        control.remove()
