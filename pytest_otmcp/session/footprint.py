"""What the processes of a session take of the machine, from ``/proc`` (Linux, proc(5))."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from ..record.schema import Footprint

__all__ = ["command_lines", "footprint", "limit_file"]

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


def limit_file(root: int | None, marker: bytes, path: Path, more: int | None) -> bool:
    """Let a file grow by so many bytes at most, or as it will again; return whether there is such a limit now.

    The limit is one of the processes that descend from ``root``, or have ``marker`` in their environment, and have the file open, or of all where
    none has. What reaches it gets EFBIG (prlimit(2),
    RLIMIT_FSIZE), unless the signal is not ignored, as Python does: such a process would be killed, and has no limit.
    """
    with suppress(OSError):
        file = path.stat()
        every = {*([] if root is None else _descendants(root)), *_marked(marker)}
        limited = [pid for pid in every if _has_open(pid, file)] or every
        if more is not None and not all(map(_ignores_limit, limited)):
            return False
        for pid in limited:
            _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (hard if more is None else file.st_size + more, hard))
        return bool(limited) and more is not None
    return False


def _marked(marker: bytes) -> Iterator[int]:
    for entry in _PROC.iterdir():
        with suppress(OSError):
            if entry.name.isdigit() and marker in (entry / "environ").read_bytes().split(b"\0"):
                yield int(entry.name)


def _has_open(pid: int, file: os.stat_result) -> bool:
    for descriptor in (_PROC / str(pid) / "fd").iterdir():
        with suppress(OSError):
            found = descriptor.stat()
            if (found.st_dev, found.st_ino) == (file.st_dev, file.st_ino):
                return True
    return False


def _ignores_limit(pid: int) -> bool:
    for line in (_PROC / str(pid) / "status").read_text().splitlines():
        if line.startswith("SigIgn:"):
            return bool(int(line.split()[1], 16) >> (signal.SIGXFSZ - 1) & 1)
    return False


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
