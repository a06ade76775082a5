"""The endpoints of a device: their declaration, and the open endpoint on which it serves."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from typing import Literal

from .cable import CableEnd

__all__ = ["Endpoint", "Kind", "OpenEndpoint"]

Kind = Literal["tcp", "udp", "pty", "cable"]

OpenEndpoint = socket.socket | int | CableEnd
"""``tcp``: a bound socket that does not listen yet; ``udp``: a bound socket; ``pty``: the master's file descriptor; ``cable``: the device's end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoint:
    """One endpoint that clients of a device use.

    A mock package declares its endpoints as ``ENDPOINTS``; the first is the one whose port ``--port`` chooses and whose
    address the ready event repeats as ``host`` and ``port``.

    Attributes:
        name: unique within the package.
        kind: a TCP port, a UDP port, a pseudo terminal in the place of a serial line, or a cable of Ethernet.
    """

    name: str
    kind: Kind
