"""A reference adapter that is led to another device than the mock: run as ``python wandering.py PROTOCOL MANNER``.

``PLANT`` is the other device's address, ``host:port`` or the path of a terminal. The manners: ``misspelt`` takes the mock's address from a variable
``ADDRESS`` and the plant's without it, ``hard-wired`` takes the plant's, ``home`` that of ``$HOME/address``, ``failover`` takes the
mock's and from the first failed connection on the plant's.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
from importlib import import_module
from pathlib import Path

from pytest_otmcp.reference_adapters.core.run import serve

SCHEMES = {"mqtt": "mqtt", "opcua": "opc.tcp"}


def split(address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    return host, int(port)


def forward(source: socket.socket, target: socket.socket) -> None:
    try:
        while data := source.recv(65536):
            target.sendall(data)
    except OSError:
        pass
    for end in (source, target):
        try:
            end.shutdown(socket.SHUT_RDWR)
        except OSError:
            continue


def relay(mock: str, plant: str) -> str:
    """Serve a port that leads to the mock as long as it is there, and to the plant ever after; return its address."""
    listener = socket.create_server(("127.0.0.1", 0))

    def accept() -> None:
        address = mock
        while True:
            inner, _ = listener.accept()
            try:
                outer = socket.create_connection(split(address))
            except OSError:
                address = plant
                inner.close()
                continue
            for pair in ((inner, outer), (outer, inner)):
                threading.Thread(target=forward, args=pair, daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    return f"127.0.0.1:{listener.getsockname()[1]}"


def address_for(manner: str) -> str:
    plant = os.environ["PLANT"]
    if manner == "misspelt":
        return os.environ.get("ADDRESS", plant)
    if manner == "home":
        return Path(os.environ["HOME"], "address").read_text(encoding="utf-8")
    if manner == "failover":
        return relay(os.environ["ADDRESS"], plant)
    return plant


def main() -> None:
    protocol, manner = sys.argv[1:3]
    address, variable = address_for(manner), protocol.upper()
    if address.startswith("/"):
        os.environ[f"{variable}_SERIAL"] = address
    elif protocol in SCHEMES:
        os.environ[f"{variable}_URL"] = f"{SCHEMES[protocol]}://{address}"
    else:
        host, port = split(address)
        os.environ |= {f"{variable}_HOST": host, f"{variable}_PORT": str(port)}
    server = import_module(f"pytest_otmcp.reference_adapters.{protocol}").build()
    if manner == "failover":
        # The relay stands for a library that changes over by itself: the adapter knows of the mock only.
        server.endpoint = server.endpoint.replace(address, os.environ["ADDRESS"])
    sys.exit(serve(server))


if __name__ == "__main__":
    main()
