"""The namespaces in which a mock device is reached (namespaces(7)), where the kit has put its adapters into some of their own."""

from __future__ import annotations

import ctypes
import os

__all__ = ["join"]

_USER, _NETWORK = 0x10000000, 0x40000000


def join(user: int, network: int) -> None:
    """Enter a user namespace and its network namespace, which these descriptors stand for. This process must have one thread.

    Raises:
        OSError: it may not.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    for descriptor, kind in ((user, _USER), (network, _NETWORK)):
        if libc.setns(descriptor, kind) != 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number), "namespace")
        os.close(descriptor)
