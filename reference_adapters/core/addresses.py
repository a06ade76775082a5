"""Addresses of host names, asked for before a library does: libraries report an unknown name like a refused connection."""

from __future__ import annotations

import asyncio
import ipaddress
import socket

from .errors import AdapterError

__all__ = ["resolve"]


async def resolve(host: str, port: int, kind: socket.SocketKind = socket.SOCK_STREAM) -> str:
    """Return the first address of a host for connections, or for datagrams; an address is returned as it is.

    Raises:
        AdapterError: there is no such name (``dns_error``).
    """
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        pass
    # Datagrams are sent from a socket of IPv4; a library that connects finds the right one of several addresses itself.
    family = socket.AF_INET if kind is socket.SOCK_DGRAM else socket.AF_UNSPEC
    try:
        found = await asyncio.get_running_loop().getaddrinfo(host, port, family=family, type=kind)
    except socket.gaierror:
        raise AdapterError("dns_error", f"the host name {host} cannot be resolved", outcome="not_sent") from None
    return str(found[0][4][0])
