"""A reference adapter that tries all the while to reach what is outside: ``python reaching_out.py FILE PROTOCOL [OPTION...]``."""

from __future__ import annotations

import json
import runpy
import socket
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

EVERY_S = 0.05


def _reach(outside: dict[str, Any]) -> None:
    places: list[tuple[int, int, Any]] = [
        (socket.AF_INET, socket.SOCK_STREAM, tuple(outside["tcp"])),
        (socket.AF_INET, socket.SOCK_DGRAM, tuple(outside["udp"])),
        (socket.AF_UNIX, socket.SOCK_STREAM, f"\0{outside['abstract']}"),
        (socket.AF_UNIX, socket.SOCK_STREAM, outside["path"]),
        (socket.AF_UNIX, socket.SOCK_STREAM, outside["home"]),
    ]
    while True:
        for family, kind, address in places:
            with suppress(OSError), socket.socket(family, kind) as one:
                one.settimeout(1)
                one.connect(address)
                one.sendall(b"plant")
        time.sleep(EVERY_S)


def main() -> None:
    """Serve as the reference adapter does, and reach out."""
    threading.Thread(
        target=_reach, args=(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")),), daemon=True
    ).start()
    del sys.argv[1]
    runpy.run_module("pytest_otmcp.reference_adapters", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
