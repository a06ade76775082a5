"""``python start.py SOCKET [-P] (FILE | -m MODULE) ARGUMENT...``: the server at SOCKET runs what ``python`` would.

The forked process enters the namespaces of this one, in whose walls the kit has put it. This process has the forked one's exit code, or 128 and the number of the signal that ended it, as in a shell. When this
process is killed, the server kills the forked one.
"""

from __future__ import annotations

import json
import os
import socket
import sys


def _privileges() -> int:
    """Return the capabilities that this process has, as bits (proc_pid_status(5))."""
    with open("/proc/self/status", encoding="ascii", errors="replace") as file:
        return next(int(line.split()[1], 16) for line in file if line.startswith("CapPrm:"))


def main() -> None:
    """Hand everything over and wait for the end."""
    path, *arguments = sys.argv[1:]
    request = {
        "arguments": arguments,
        "directory": os.getcwd(),
        "environment": dict(os.environ),
        "privileges": _privileges(),
    }
    line = json.dumps(request).encode() + b"\n"
    namespaces = [os.open(f"/proc/self/ns/{kind}", os.O_RDONLY) for kind in ("user", "net", "mnt", "ipc", "uts", "pid")]
    with socket.socket(socket.AF_UNIX) as server:
        server.connect(path)
        sent = socket.send_fds(server, [line], [0, 1, 2, *namespaces])
        server.sendall(line[sent:])
        # The reader of a stream sees its end when the forked process closes it, not later.
        for stream in range(3):
            os.close(stream)
        code = int(server.makefile().readline())
    os._exit(code if code >= 0 else 128 - code)


if __name__ == "__main__":
    main()
