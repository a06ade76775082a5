"""A list of what a Python process connects to: imported by every Python that has this directory on its PYTHONPATH.

``WATCH_LOG`` is the file of the list; a line has the address that was connected to or sent to, and that of the mock device as
``WATCH_MOCK`` has it. What a process connects to itself, such as a pair of sockets, is not listed.
"""

import os
import socket
import stat
import sys
from typing import Any

LOG, MOCK = os.environ["WATCH_LOG"], os.environ["WATCH_MOCK"]


def _listens(address: tuple[Any, ...]) -> bool:
    for name in os.listdir("/proc/self/fd"):
        try:
            if not stat.S_ISSOCK(os.stat(f"/proc/self/fd/{name}").st_mode):
                continue
            own = socket.socket(fileno=os.dup(int(name)))
        except OSError:
            continue
        with own:
            if own.getsockname()[:2] == address and own.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                return True
    return False


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if event in ("socket.connect", "socket.sendto") and isinstance(arguments[1], tuple):
        address = arguments[1][:2]
        if not _listens(address):
            with open(LOG, "a", encoding="utf-8") as log:
                log.write(f"{address[0]}:{address[1]} {MOCK}\n")


sys.addaudithook(_watch)
