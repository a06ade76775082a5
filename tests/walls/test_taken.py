"""A port is taken where the device and its adapters are; who has its number in another network does not matter."""

from __future__ import annotations

import asyncio
import socket

from pytest_otmcp.core.errors import ExhaustedError
from pytest_otmcp.plant.endpoint import Endpoint, check_free
from pytest_otmcp.session.isolation import Walls

from .test_walls import isolation_or_skip


def _listening(sock: socket.socket, port: int) -> socket.socket:
    sock.bind(("127.0.0.1", port))
    sock.listen()
    return sock


async def _taken(endpoints: list[Endpoint], walls: Walls | None) -> bool:
    try:
        await check_free(endpoints, walls)
    except ExhaustedError:
        return True
    return False


def test_only_who_listens_in_the_network_of_a_device_has_taken_its_port() -> None:
    isolation = isolation_or_skip()
    try:
        walls = isolation.walls()
        with _listening(socket.socket(), 0) as outside:
            port = outside.getsockname()[1]
            endpoints = [Endpoint(name="tcp", kind="tcp", host="127.0.0.1", port=port)]
            assert asyncio.run(_taken(endpoints, None))
            assert not asyncio.run(_taken(endpoints, walls))
            assert walls is not None
            with _listening(walls.socket(socket.SOCK_STREAM), port):
                assert asyncio.run(_taken(endpoints, walls))
    finally:
        isolation.close()
