"""The process at the other end of a tap's connection. Mock devices find theirs by themselves: kit and mocks share no code."""

from __future__ import annotations

import asyncio
import contextlib
import os
from typing import Any

import psutil

from ..owners import TOKEN_VARIABLE, PeerProcess

__all__ = ["holder_of", "process_of", "sender_of"]

_ANYWHERE = ("0.0.0.0", "::")  # noqa: S104  (what an unbound sender's socket says of itself)


def process_of(transport: asyncio.BaseTransport) -> PeerProcess | None:
    """Return the process that has the other end of a TCP connection; None if that cannot be known."""
    return holder_of(transport.get_extra_info("peername"), transport.get_extra_info("sockname"))


def holder_of(end: Any, other: Any) -> PeerProcess | None:
    """Return the process that has one end of a TCP connection, of which both addresses are given; None if that cannot be known."""
    return _process("tcp", lambda one: one.laddr == end and one.raddr == other)


def sender_of(address: Any) -> PeerProcess | None:
    """Return the process that sends datagrams from an address; None if that cannot be known."""
    host, port = address[:2]
    return _process(
        "udp", lambda one: bool(one.laddr) and one.laddr.port == port and one.laddr.ip in (host, *_ANYWHERE)
    )


def _process(kind: str, is_peer: Any) -> PeerProcess | None:
    with contextlib.suppress(psutil.Error, OSError):
        pid = next((one.pid for one in psutil.net_connections(kind) if is_peer(one)), None)
        if pid is not None:
            return _found(psutil.Process(pid))
    return None


def _found(process: psutil.Process) -> PeerProcess | None:
    contained = os.stat(f"/proc/{process.pid}/ns/pid").st_ino != os.stat("/proc/self/ns/pid").st_ino
    ancestors = tuple(parent.pid for parent in process.parents())
    token = None
    with contextlib.suppress(psutil.AccessDenied):
        token = process.environ().get(TOKEN_VARIABLE)
    return PeerProcess(pid=process.pid, name=process.name(), ancestors=ancestors, token=token, contained=contained)
