"""The endpoints of a device: what adapters connect to, send datagrams to, or open."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from ..core.errors import ExhaustedError
from ..record.schema import Endpoint as EndpointFacts
from ..session.isolation import Walls

__all__ = ["Endpoint", "check_free", "endpoint_values", "first_port", "occupied"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoint:
    """One endpoint of a device. Its address stays the same while the device is stopped and started.

    Attributes:
        name: unique within the device, in the protocol's words; not ``http`` or ``local``, because ``{http_port}`` and ``{local_port}``
            in a subject file are ports of the adapter.
        kind: a TCP port, a UDP port, a pseudo terminal in the place of a serial line, or a cable of Ethernet.
        host, port: of a port; empty and 0 for a pseudo terminal. A cable has the device's address, and no port.
        path: of a pseudo terminal, or the name of the interface that adapters have at a cable; empty for a port.
        mac: hardware address of the device on a cable; else empty.
        join: number of a process in the network of a cable; else 0.
    """

    name: str
    kind: Literal["tcp", "udp", "pty", "cable"]
    host: str = ""
    port: int = 0
    path: str = ""
    mac: str = ""
    join: int = 0

    def facts(self) -> EndpointFacts:
        """Return what ``run.json`` says about it."""
        told: EndpointFacts = {
            "name": self.name,
            "kind": self.kind,
            "host": self.host,
            "port": self.port,
            "path": self.path,
        }
        if self.mac:
            told["mac"] = self.mac
        return told


def first_port(endpoints: Mapping[str, Endpoint]) -> Endpoint | None:
    """Return the first endpoint that is a TCP or UDP port; None if there is none."""
    return next((endpoint for endpoint in endpoints.values() if endpoint.port), None)


def endpoint_values(scheme: str, endpoints: Mapping[str, Endpoint]) -> dict[str, str]:
    """Return the placeholders of a subject file that stand for a device's endpoints, each with its value.

    ``host``, ``port`` and ``url`` are those of its first port, ``NAME_port`` is any further port, ``serial`` is the path of its
    first pseudo terminal, which is also the ``url`` of a device without a port. ``interface`` is the adapter's end of a cable,
    ``device_mac`` and ``device_ip`` are the addresses at the other end.

    Args:
        scheme: of the URL.
        endpoints: by name, the main one first.
    """
    main = first_port(endpoints)
    lines = [endpoint.path for endpoint in endpoints.values() if endpoint.kind == "pty"]
    values: dict[str, str] = {}
    if main is not None:
        values = {"host": main.host, "port": str(main.port), "url": f"{scheme}://{main.host}:{main.port}"}
    elif lines:
        values = {"url": f"{scheme}://{lines[0]}"}
    if lines:
        values["serial"] = lines[0]
    for cable in (endpoint for endpoint in endpoints.values() if endpoint.kind == "cable"):
        values |= {"interface": cable.path, "device_mac": cable.mac, "device_ip": cable.host}
        values.setdefault("url", f"{scheme}:///{cable.path}")
    further = (endpoint for endpoint in endpoints.values() if endpoint.port and endpoint is not main)
    return values | {f"{endpoint.name}_port": str(endpoint.port) for endpoint in further}


def occupied(endpoint: Endpoint) -> ExhaustedError:
    """Return the error that says that another program has taken an endpoint while its device was away."""
    return ExhaustedError(
        f"another program has taken {endpoint.host}:{endpoint.port}, the address of a mock device, while the device was stopped; "
        "end that program (`ss -ltnp` names it) and run again"
    )


async def check_free(endpoints: Iterable[Endpoint], walls: Walls | None) -> None:
    """Make sure that nobody listens on the TCP ports of a device that is stopped; nothing is sent to who does.

    Args:
        walls: around the adapters of the device; the ports are in the network there.

    Raises:
        ExhaustedError: another program does. On Linux one of the same user can take a port that is only reserved (SO_REUSEPORT).
    """
    loop = asyncio.get_running_loop()
    for endpoint in endpoints:
        if endpoint.kind != "tcp":
            continue
        # In another network others have these ports. Where nobody has one, the system may give it to the socket that asks, which is
        # then connected to itself.
        with socket.socket() if walls is None else walls.socket(socket.SOCK_STREAM) as probe:
            probe.setblocking(False)
            try:
                await loop.sock_connect(probe, (endpoint.host, endpoint.port))
            except OSError:
                continue
        raise occupied(endpoint)
