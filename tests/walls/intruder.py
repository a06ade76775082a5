"""A hostile program: it tries everything that a wall is for, and prints as JSON what worked.

``python intruder.py JSON``: where the targets are, see :class:`~tests.walls.outside.Outside`.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import resource
import signal
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

MARK = b"intruder"
PTRACE_ATTACH, PTRACE_DETACH = 16, 17


def _sends(family: int, kind: int, address: Any) -> Callable[[], bool]:
    def send() -> bool:
        with socket.socket(family, kind) as one:
            one.settimeout(5)
            one.connect(address)
            one.sendall(MARK)
        return True

    return send


def _writes(path: str) -> Callable[[], bool]:
    def write() -> bool:
        Path(path).write_text("written", encoding="utf-8")
        return True

    return write


def _fills(path: str) -> Callable[[], bool]:
    def fill() -> bool:
        # Without waiting: a pipe that nobody reads has no other end.
        descriptor = os.open(path, os.O_WRONLY | os.O_NONBLOCK)
        try:
            return os.write(descriptor, MARK) > 0
        finally:
            os.close(descriptor)

    return fill


def _reads_a_secret_of_others() -> bool:
    """The environment of a process that has been started by somebody else."""
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if entry.name.isdigit() and b"SECRET_OF_THE_SHELL=" in (entry / "environ").read_bytes():
                return True
    return False


def _sees_the_disk() -> bool:
    """A device of blocks, which holds what no file system shows."""
    return any(path.is_block_device() for path in Path("/dev").iterdir())


def _gains_privileges() -> bool:
    status = dict(line.split(":\t", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(status["CapEff"], 16) != 0 or int(status["CapBnd"], 16) != 0 or status["NoNewPrivs"] != "1"


def _signals(number: int) -> Callable[[], bool]:
    def send() -> bool:
        os.kill(number, 0)
        return True

    return send


def _breeds(seconds: float) -> bool:
    """Leave a chain of processes, of which each starts the next and ends."""
    if seconds and os.fork() == 0:
        os.setsid()
        for descriptor in range(3):
            os.close(descriptor)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if os.fork() != 0:
                os._exit(0)
            time.sleep(0.002)
        os._exit(0)
    return seconds > 0


def _limits(number: int) -> Callable[[], bool]:
    def limit() -> bool:
        resource.prlimit(number, resource.RLIMIT_MSGQUEUE, (0, 0))
        return True

    return limit


def _traces(number: int) -> Callable[[], bool]:
    def trace() -> bool:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.ptrace(PTRACE_ATTACH, number, None, None) < 0:
            return False
        os.waitpid(number, 0)
        libc.ptrace(PTRACE_DETACH, number, None, None)
        return True

    return trace


def _moves() -> bool:
    os.rename("reports", "elsewhere")
    return True


def _puts_a_pipe_in_place_of_a_file() -> bool:
    os.unlink("run.json")
    os.mkfifo("run.json")
    return True


def main() -> None:
    """Try, and say what worked."""
    outside = json.loads(sys.argv[1])
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    other = outside["process"]
    attempts: dict[str, Callable[[], bool]] = {
        "connects to a TCP port": _sends(socket.AF_INET, socket.SOCK_STREAM, tuple(outside["tcp"])),
        "sends a UDP datagram": _sends(socket.AF_INET, socket.SOCK_DGRAM, tuple(outside["udp"])),
        "connects to an abstract Unix socket": _sends(socket.AF_UNIX, socket.SOCK_STREAM, f"\0{outside['abstract']}"),
        "connects to a Unix socket below `/tmp`": _sends(socket.AF_UNIX, socket.SOCK_STREAM, outside["path"]),
        "connects to a Unix socket elsewhere": _sends(socket.AF_UNIX, socket.SOCK_STREAM, outside["home"]),
        "connects to a Unix socket that was renamed": _sends(socket.AF_UNIX, socket.SOCK_STREAM, outside["renamed"]),
        "writes into a pipe": _fills(outside["pipe"]),
        "signals another process": _signals(other),
        "traces another process": _traces(other),
        "limits the resources of another process": _limits(other),
        "writes to the standard output of another process": _writes(f"/proc/{other}/fd/1"),
        "reads the environment of another process": _reads_a_secret_of_others,
        "leaves a chain of processes that fork and exit": lambda: _breeds(outside["breed"]),
        "writes a file": _writes(outside["file"]),
        "writes a file below `/tmp`": _writes(f"/tmp/{outside['abstract']}"),  # noqa: S108
        "writes a `conftest.py` in its working directory": _writes("conftest.py"),
        "moves a folder of its working directory": _moves,
        "puts a pipe in place of a file": _puts_a_pipe_in_place_of_a_file,
        "declared": _writes(outside["work"]),
        "disk": _sees_the_disk,
        "privileges": _gains_privileges,
    }
    worked = {}
    for name, attempt in attempts.items():
        try:
            worked[name] = attempt()
        except OSError:
            worked[name] = False
    print(json.dumps(worked), flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main()
