"""The process at the other end of a connection, found when the connection is accepted.

The kernel knows which socket is at the other end (sock_diag(7)), and ``/proc`` which process holds it. To ask the kernel for one
socket takes 10 microseconds; ``/proc/net/tcp``, which libraries read, took 4 milliseconds on the same machine. A process that
was found once is looked at first the next time, where its next descriptor would be; only when none of those holds the socket, all
processes are looked at.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import fcntl
import itertools
import os
import socket
import struct
from collections import OrderedDict
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cache

__all__ = ["Process", "client", "holder", "process_of", "socket_of", "stay_in_network", "terminal_holder"]

_SOCK_DIAG = 4
_BY_FAMILY = 20
_REQUEST = 1
_HEADER = struct.Struct("=IHHII")
_QUERY = struct.Struct("=BBBxI")
_ANY_STATE = 0xFFFFFFFF
_ANY_COOKIE = b"\xff" * 8
# In the answer the inode is behind the header, four bytes of state, the addresses, and four other numbers.
_INODE_AT = _HEADER.size + 4 + 48 + 16
_TOKEN = b"OTMCP_SESSION="
_MOST_KNOWN = 32
_NEXT = 4
"""A process that opens one connection after the other gets one of the next descriptors for each."""
_MOST_LOOKED_AT = 4096
"""Descriptors of a process, the highest first. Who hides a connection behind more of them gains nothing: what cannot be known counts for the
adapter."""
_GET_NUMBER = 0x80045430
"""TIOCGPTN of ioctl_tty(2): the number of the terminal that belongs to a master."""

Address = tuple[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Process:
    """A process that has a connection.

    Attributes:
        pid: its number.
        name: of its program, as the kernel has it.
        ancestors: numbers of its parent, of the parent's parent, and so on, when it was found.
        token: what the kit has given its session; None for a process that has none in its environment.
        contained: it is in another namespace of processes than this one. One that is nested in this one is seen with its numbers of
            here, and so are its parents; one that a service has started, as that of containers does, has no parent that is known.
    """

    pid: int
    name: str
    ancestors: tuple[int, ...]
    token: str | None
    contained: bool = False


@dataclass(slots=True)
class _Known:
    process: Process
    place: str

    def near_the_same_place(self, link: str) -> bool:
        directory, _, number = self.place.rpartition("/")
        for place in (f"{directory}/{int(number) + further}" for further in range(_NEXT)):
            if _link(place) == link:
                self.place = place
                return True
        return False

    def anywhere(self, link: str) -> bool:
        place = _place(self.process.pid, link)
        self.place = place or self.place
        return place is not None


_known: OrderedDict[tuple[int, str | None], _Known] = OrderedDict()
"""Processes by number and time of their start, the one that was found last at the end."""


def stay_in_network() -> None:
    """Go on asking for the sockets of the network in which this process is now, also when it has left that."""
    _kernel()


def process_of(transport: asyncio.BaseTransport) -> Process | None:
    """Return the process that has the other end of a TCP connection.

    None when it cannot be known: the other end is closed already, belongs to a process of another user, or the system is not Linux.
    """
    own, peer = transport.get_extra_info("sockname"), transport.get_extra_info("peername")
    return holder(_inode(socket.IPPROTO_TCP, peer, own))


def socket_of(own: Address, peer: Address) -> int:
    """Return the number of the socket from which datagrams come; 0 if it is not known.

    An address may belong to one socket after the other, a number belongs to one.
    """
    # The kernel takes the addresses of a datagram socket the other way round.
    return _inode(socket.IPPROTO_UDP, own, peer)


_numbers = itertools.count(1)


@cache
def _kernel() -> socket.socket:
    kernel = socket.socket(socket.AF_NETLINK, socket.SOCK_DGRAM, _SOCK_DIAG)
    # A device in a process of its own ends without this; a test that has one in its own process would be warned at its end.
    atexit.register(kernel.close)
    return kernel


def _inode(protocol: int, local: Address, remote: Address) -> int:
    """Return the number of the socket with these two addresses, 0 when there is none."""
    addresses = b"".join(socket.inet_aton(host).ljust(16, b"\0") for host, _ in (local, remote))
    ports = struct.pack(">HH", local[1], remote[1])
    query = _QUERY.pack(socket.AF_INET, protocol, 0, _ANY_STATE) + ports + addresses + bytes(4) + _ANY_COOKIE
    number, answered = next(_numbers), None
    try:
        kernel = _kernel()
        kernel.send(_HEADER.pack(_HEADER.size + len(query), _BY_FAMILY, _REQUEST, number, 0) + query)
        while answered != number:
            # The answer is there when the question has been sent.
            answer = kernel.recv(4096, socket.MSG_DONTWAIT)
            _, kind, _, answered, _ = _HEADER.unpack_from(answer)
    except (AttributeError, OSError):
        return 0
    return int(struct.unpack_from("=I", answer, _INODE_AT)[0]) if kind == _BY_FAMILY else 0


def holder(number: int) -> Process | None:
    """Return the process that has the socket of this number; None if that is 0, or no process that can be seen has it."""
    return _having(f"socket:[{number}]") if number else None


def terminal_holder(master: int) -> tuple[Process | None, tuple[int, str | None] | None]:
    """Return the process that has a pseudo terminal open, and a key that no later process has; (None, None) if none can be seen.

    The device and its launcher, which keep it open, are not meant. Of several others it is one.

    Args:
        master: file descriptor of the terminal's other side.
    """
    try:
        (number,) = struct.unpack("=I", fcntl.ioctl(master, _GET_NUMBER, bytes(4)))
    except OSError:
        return None, None
    process = _having(f"/dev/pts/{number}", besides=(os.getpid(), os.getppid()))
    return process, None if process is None else (process.pid, _start(process.pid))


def _having(link: str, besides: Collection[int] = ()) -> Process | None:
    """Return the process that has a file descriptor which is a link to this; None if none that can be seen has."""
    # A process that connects anew for each request gets the same file descriptor for it.
    for looked_at in (_Known.near_the_same_place, _Known.anywhere):
        for key, known in reversed(_known.items()):
            if looked_at(known, link) and _start(known.process.pid) == key[1]:
                _known.move_to_end(key)
                return known.process
    # The youngest first: what a process has opened and handed on to a child is found at the child.
    for pid in sorted((int(name) for name in os.listdir("/proc") if name.isdigit()), reverse=True):
        if pid not in besides and (place := _place(pid, link)) is not None:
            return _found(pid, place)
    return None


def client(connection: socket.socket) -> Process | None:
    """Return the process that has connected to a Unix socket (SO_PEERCRED, unix(7)); None if it cannot be seen any more."""
    pid, _, _ = struct.unpack("=iII", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    try:
        return _process(pid)
    except OSError:
        return None


def _place(pid: int, link: str) -> str | None:
    """Return the file descriptor of a process, as a path, that is this socket; None if it has none."""
    directory = f"/proc/{pid}/fd"
    try:
        numbers = sorted(map(int, os.listdir(directory)), reverse=True)
    except OSError:
        # It has ended, or it belongs to somebody else.
        return None
    places = (f"{directory}/{number}" for number in numbers[:_MOST_LOOKED_AT])
    return next((place for place in places if _link(place) == link), None)


def _link(path: str) -> str | None:
    try:
        return os.readlink(path)
    except OSError:
        # Closed meanwhile.
        return None


def _found(pid: int, place: str) -> Process | None:
    try:
        process = _process(pid)
    except OSError:
        return None
    _known[pid, _start(pid)] = _Known(process, place)
    if len(_known) > _MOST_KNOWN:
        _known.popitem(last=False)
    return process


def _process(pid: int) -> Process:
    contained = os.stat(f"/proc/{pid}/ns/pid").st_ino != os.stat("/proc/self/ns/pid").st_ino
    return Process(pid=pid, name=_name(pid), ancestors=tuple(_ancestors(pid)), token=_token(pid), contained=contained)


def _stat(pid: int) -> list[str]:
    """Fields of ``/proc/PID/stat`` behind the name, which may hold blanks and brackets (proc_pid_stat(5))."""
    with open(f"/proc/{pid}/stat", encoding="utf-8", errors="replace") as file:
        return file.read().rpartition(")")[2].split()


def _start(pid: int) -> str | None:
    try:
        return _stat(pid)[19]
    except OSError:
        return None


def _ancestors(pid: int) -> Iterator[int]:
    with contextlib.suppress(OSError):
        # A parent may end meanwhile.
        while (pid := int(_stat(pid)[1])) > 0:
            yield pid


def _name(pid: int) -> str:
    with open(f"/proc/{pid}/comm", encoding="utf-8", errors="replace") as file:
        return file.read().rstrip("\n")


def _token(pid: int) -> str | None:
    with open(f"/proc/{pid}/environ", "rb") as file:
        variables = file.read().split(b"\0")
    return next(
        (one.removeprefix(_TOKEN).decode("ascii", "replace") for one in variables if one.startswith(_TOKEN)), None
    )
