"""A hostile program: it tries everything that a wall is for, and prints as JSON what worked.

``python intruder.py JSON``: where the targets are, see :class:`~tests.walls.outside.Outside`.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

MARK = b"intruder"


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


def main() -> None:
    """Try, and say what worked."""
    outside = json.loads(sys.argv[1])
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    attempts: dict[str, Callable[[], bool]] = {
        "tcp": _sends(socket.AF_INET, socket.SOCK_STREAM, tuple(outside["tcp"])),
        "udp": _sends(socket.AF_INET, socket.SOCK_DGRAM, tuple(outside["udp"])),
        "abstract": _sends(socket.AF_UNIX, socket.SOCK_STREAM, f"\0{outside['abstract']}"),
        "path": _sends(socket.AF_UNIX, socket.SOCK_STREAM, outside["path"]),
        "home": _sends(socket.AF_UNIX, socket.SOCK_STREAM, outside["home"]),
        "signal": _signals(outside["process"]),
        "secret": _reads_a_secret_of_others,
        "disk": _sees_the_disk,
        "privileges": _gains_privileges,
        "file": _writes(outside["file"]),
        "own": _writes("own.txt"),
        "temporary": _writes(f"/tmp/{outside['abstract']}"),  # noqa: S108
        "work": _writes(outside["work"]),
        "breed": lambda: _breeds(outside["breed"]),
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
