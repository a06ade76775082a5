"""Files that somebody else may have made: only regular ones are read, and none that is larger than any of its kind."""

from __future__ import annotations

from pathlib import Path

from ..core.errors import UsageError
from ..core.files import regular
from . import Refusal

__all__ = ["LARGEST_CERTIFICATE", "LARGEST_RECORD", "content", "size"]

LARGEST_CERTIFICATE = 16 << 20
LARGEST_RECORD = 2 << 30
"""Bytes. The record of a run of 30 repetitions has 7 MB."""


def size(path: Path, largest: int) -> int:
    """Return the bytes that a file has; it is not opened.

    Raises:
        UsageError: there is no such file, or it is a directory, a pipe or a device.
        Refusal: it is larger than any of its kind.
    """
    if not path.is_file():
        raise UsageError(f"{path}: {_no_file(path)}")
    found = path.stat().st_size
    if found > largest:
        raise Refusal(f"refused: {path} has {found} bytes, more than {largest}")
    return found


def _no_file(path: Path) -> str:
    if path.is_dir():
        return "this is a folder and no regular file; name the file in it"
    return "this is no regular file" if path.exists() else "there is no such file"


def content(path: Path, largest: int) -> bytes:
    """Return a file's content, read once.

    Raises:
        UsageError, Refusal: those of :func:`size`.
    """
    size(path, largest)
    with open(path, "rb", opener=regular) as file:
        found = file.read(largest + 1)
    if len(found) > largest:
        raise Refusal(f"refused: {path} has more than {largest} bytes")
    return found
