"""The namespaces in which a mock device is reached (namespaces(7)): those into which the kit has put its adapters, or new ones."""

from __future__ import annotations

import ctypes
import os
import signal

__all__ = ["enter_new", "hold", "join", "unshare_network"]

_USER, _NETWORK = 0x10000000, 0x40000000
_SET_PDEATHSIG = 1


def _call(function: str, *arguments: int, step: str) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if getattr(libc, function)(*arguments) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), step)


def join(user: int, network: int) -> None:
    """Enter a user namespace and its network namespace, which these descriptors stand for. This process must have one thread.

    Raises:
        OSError: it may not.
    """
    for descriptor, kind in ((user, _USER), (network, _NETWORK)):
        _call("setns", descriptor, kind, step="namespace")
        os.close(descriptor)


def enter_new() -> None:
    """Enter a new user namespace, as its root, and a new network namespace. This process must have one thread.

    Root, so that a program that joins keeps its capabilities when it is executed, packet sockets among them (capabilities(7)).

    Raises:
        OSError: this machine does not let this user have one.
    """
    user, group = os.geteuid(), os.getegid()
    _call("unshare", _USER, step="a user namespace")
    for name, line in (("setgroups", "deny"), ("uid_map", f"0 {user} 1"), ("gid_map", f"0 {group} 1")):
        with open(f"/proc/self/{name}", "w", encoding="ascii") as file:
            file.write(line)
    unshare_network()


def unshare_network() -> None:
    """Enter a new network namespace.

    Raises:
        OSError: this machine refuses.
    """
    _call("unshare", _NETWORK, step="a network namespace")


def hold() -> int:
    """Fork a process that stays in these namespaces for as long as this one lives, and can be joined by others; return its number."""
    parent = os.getpid()
    if number := os.fork():
        return number
    try:
        ctypes.CDLL(None).prctl(_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:
            # It has ended already, and no signal will come.
            os._exit(0)
        os.closerange(0, 256)
        while True:
            signal.pause()
    finally:
        os._exit(0)
