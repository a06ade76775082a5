"""What the processes of a session take of the machine, from ``/proc`` (Linux, proc(5))."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from ..record.schema import Footprint

__all__ = ["command_lines", "footprint"]

_PROC = Path("/proc")
_LAZY = ("java", "node", "nodejs", "bun", "deno", "dotnet")
_LAZY_LIBRARIES = (b"libjvm.so", b"libcoreclr.so")
"""Programs and libraries of runtimes whose heap grows up to a limit before anything is freed."""
_PAGE_KIB = os.sysconf("SC_PAGE_SIZE") // 1024


def footprint(root: int | None) -> Footprint:
    """Return the figures of every process that descends from ``root``, which is the kit's own and does not count."""
    found: Footprint = {"rss_kib": 0, "descriptors": 0, "threads": 0, "processes": 0}
    for pid in () if root is None else _descendants(root):
        try:
            pages = int((_PROC / str(pid) / "statm").read_text().split()[1])
            descriptors = len(list((_PROC / str(pid) / "fd").iterdir()))
            threads = len(list((_PROC / str(pid) / "task").iterdir()))
        except (OSError, IndexError, ValueError):
            # It has ended meanwhile.
            continue
        found["rss_kib"] += pages * _PAGE_KIB
        found["descriptors"] += descriptors
        found["threads"] += threads
        found["processes"] += 1
        if _has_lazy_heap(_PROC / str(pid)):
            found["lazy_heap"] = True
    return found


def _has_lazy_heap(process: Path) -> bool:
    try:
        return (process / "exe").readlink().name in _LAZY or any(
            name in (process / "maps").read_bytes() for name in _LAZY_LIBRARIES
        )
    except OSError:
        return False


def command_lines(root: int | None) -> Iterator[bytes]:
    """Return the arguments of every process that descends from ``root``, which anybody on the machine can read."""
    for pid in () if root is None else _descendants(root):
        with suppress(OSError):
            yield (_PROC / str(pid) / "cmdline").read_bytes()


def _descendants(root: int) -> list[int]:
    children: dict[int, list[int]] = {}
    for entry in _PROC.iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            children.setdefault(int(fields[1]), []).append(int(entry.name))
    found, waiting = [], list(children.get(root, ()))
    while waiting:
        pid = waiting.pop()
        found.append(pid)
        waiting += children.get(pid, ())
    return found
