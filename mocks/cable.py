"""A cable between two network interfaces: one is where the adapters are, the other where the device is.

Both are made over netlink (rtnetlink(7), veth(4)), in network namespaces that hold nothing else, so that no frame can reach a real network.
IPv6 is switched off on them: the cable carries what adapter and device send, and nothing besides. The interfaces are there as long
as the launcher is, whichever device runs. Run as a program, this tells whether the machine allows a cable.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import struct
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import IO

from . import peer
from .namespaces import enter_new, unshare_network

__all__ = ["ADAPTER_IP", "DEVICE_IP", "INTERFACE", "CableEnd", "Plugged"]

INTERFACE = "otmcp0"
"""Name of both interfaces, each in its own namespace."""
ADAPTER_IP, DEVICE_IP = "10.77.0.1", "10.77.0.2"

_NEW_LINK, _ACK, _EXCLUSIVE, _CREATE, _REQUEST, _UP = 16, 0x4, 0x200, 0x400, 0x1, 0x1
_NAME, _LINK_INFO, _NAMESPACE = 3, 18, 28
_KIND, _DATA, _PEER = 1, 2, 1
_SET_ADDRESS, _SET_MASK, _GET_HARDWARE_ADDRESS, _GET_FLAGS = 0x8916, 0x891C, 0x8927, 0x8913
_RUNNING = 0x40
_INDEX = 1000
"""Number of the device's interface."""
_PATIENCE_S = 60.0
_IGNORE_OUTGOING, _SOL_PACKET, _EVERY_PROTOCOL = 23, 263, 3
_BUFFER = 4 * 1024 * 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class CableEnd:
    """The device's end of a cable, as a device process has it.

    Attributes:
        socket: a packet socket that hears all frames of the adapters, and does not block.
        mac: hardware address of the interface.
        sockets: the kernel's list of packet sockets in the adapters' namespace (``/proc/net/packet``).
    """

    socket: socket.socket
    mac: bytes
    sockets: IO[bytes]


class Plugged:
    """The interfaces of a cable. The process that makes it has its own interface, and the namespace that it was in has the adapters'.

    Attributes:
        mac: hardware address of the device's interface.
    """

    def __init__(self) -> None:
        """Make the cable.

        Raises:
            OSError: the machine refuses.
        """
        peer.stay_in_network()
        self._sockets = open("/proc/thread-self/net/packet", "rb", buffering=0)  # noqa: SIM115
        here = os.open("/proc/thread-self/ns/net", os.O_RDONLY | os.O_CLOEXEC)
        theirs = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        _without_ipv6()
        with _netlink() as there:
            unshare_network()
            _without_ipv6()
            with _netlink() as own, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours, theirs:
                far = _attribute(_PEER, _link() + _name(INTERFACE) + _attribute(_NAMESPACE, struct.pack("=i", here)))
                info = _attribute(_KIND, b"veth\0") + _attribute(_DATA, far)
                # The kernel tells of a carrier at once only where the two ends have different numbers, else once a second.
                _ask(own, _CREATE | _EXCLUSIVE, _link(index=_INDEX) + _name(INTERFACE) + _attribute(_LINK_INFO, info))
                for netlink, any_socket, address in ((own, ours, DEVICE_IP), (there, theirs, ADAPTER_IP)):
                    _ask(netlink, 0, _link(_UP) + _name(INTERFACE))
                    for request, value in ((_SET_ADDRESS, address), (_SET_MASK, "255.255.255.0")):
                        inet = struct.pack("=HH4s8x", socket.AF_INET, 0, socket.inet_aton(value))
                        fcntl.ioctl(any_socket, request, INTERFACE.encode().ljust(16, b"\0") + inet)
                _ask(own, 0, _link(_UP) + _name("lo"))
                for any_socket in (ours, theirs):
                    _until_running(any_socket)
                told = fcntl.ioctl(ours, _GET_HARDWARE_ADDRESS, INTERFACE.encode().ljust(40, b"\0"))
        os.close(here)
        self.mac = told[18:24]

    def open(self) -> CableEnd:
        """Return the device's end, which has heard nothing yet."""
        end = socket.socket(socket.AF_PACKET, socket.SOCK_RAW | socket.SOCK_NONBLOCK, 0)
        end.setsockopt(_SOL_PACKET, _IGNORE_OUTGOING, 1)
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        end.bind((INTERFACE, _EVERY_PROTOCOL))
        return CableEnd(socket=end, mac=self.mac, sockets=self._sockets)

    def close(self) -> None:
        """Give the list of sockets up; the interfaces end with the namespace."""
        self._sockets.close()


def _without_ipv6() -> None:
    with (
        suppress(FileNotFoundError),
        open("/proc/sys/net/ipv6/conf/default/disable_ipv6", "w", encoding="ascii") as file,
    ):
        file.write("1")


def _netlink() -> socket.socket:
    made = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE)
    made.bind((0, 0))
    return made


def _ask(netlink: socket.socket, flags: int, body: bytes) -> None:
    netlink.send(struct.pack("=IHHII", 16 + len(body), _NEW_LINK, flags | _REQUEST | _ACK, 1, 0) + body)
    (code,) = struct.unpack_from("=i", netlink.recv(4096), 16)
    if code:
        raise OSError(-code, os.strerror(-code), "a virtual cable (veth)")


def _link(flags: int = 0, index: int = 0) -> bytes:
    return struct.pack("=BxHiII", 0, 0, index, flags, flags)


def _until_running(any_socket: socket.socket) -> None:
    """Wait for what the kernel does after the answer that an interface is up: clients look at IFF_RUNNING before they send."""
    ends = time.monotonic() + _PATIENCE_S
    while (
        not struct.unpack_from("=H", fcntl.ioctl(any_socket, _GET_FLAGS, INTERFACE.encode().ljust(40, b"\0")), 16)[0]
        & _RUNNING
    ):
        if time.monotonic() > ends:
            raise TimeoutError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT), "a virtual cable (veth)")
        time.sleep(0.001)


def _attribute(kind: int, data: bytes) -> bytes:
    return struct.pack("=HH", 4 + len(data), kind) + data + bytes(-len(data) % 4)


def _name(name: str) -> bytes:
    return _attribute(_NAME, name.encode() + b"\0")


def _try() -> None:
    try:
        enter_new()
        plugged = Plugged()
        plugged.open().socket.close()
        plugged.close()
    except OSError as error:
        step = error.filename or "a packet socket"
        sys.exit(f"this machine refuses {step} ({error.strerror})")


if __name__ == "__main__":
    _try()
