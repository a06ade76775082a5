"""A port of the loopback interface for a server that has to be told it before it exists."""

from __future__ import annotations

import random
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

__all__ = ["free_port"]

_LOWEST = 10_000
_RANGE = Path("/proc/sys/net/ipv4/ip_local_port_range")
_CHANCE = random.SystemRandom()
_TRIES = 1000


def free_port(new_socket: Callable[[], socket.socket]) -> int:
    """Return a port that nobody has and that the system hands out to nobody.

    Every connection of every program gets its port out of the system's own range; one of that range could be taken before the server
    has it.

    Args:
        new_socket: returns a socket of the kind, and in the network, that the server will have.

    Raises:
        OSError: of a thousand ports each was taken.
    """
    end = max(int(_RANGE.read_text().split()[0]), _LOWEST + 1)
    for _ in range(_TRIES):
        port = _CHANCE.randrange(_LOWEST, end)
        with suppress(OSError), new_socket() as probe:
            probe.bind(("127.0.0.1", port))
            return port
    raise OSError(f"of {_TRIES} ports between {_LOWEST} and {end} each was taken")
