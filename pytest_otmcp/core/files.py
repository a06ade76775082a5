"""Files that somebody else may have replaced: a regular file is opened, and nothing that would make the kit wait.

Whoever opens a FIFO waits for its other end, for ever if there is none; to open a device may change it.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import BinaryIO

__all__ = ["digest", "new_file", "new_file_below", "no_link", "read", "regular", "remove_below", "remove_tree"]

_WITHOUT_WAITING = os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC
_LARGEST = 1 << 28
"""Bytes of the largest file that is digested."""


def regular(path: str | os.PathLike[str], flags: int) -> int:
    """Open a file, as the ``opener`` of :func:`open`; symbolic links are followed.

    Raises:
        OSError: it is not there, cannot be opened, or is a FIFO, a socket, a device or a directory.
    """
    return _opened(path, flags, follow=True)


def no_link(path: str | os.PathLike[str], flags: int) -> int:
    """Open a file as :func:`regular` does, but nothing that a symbolic link leads to: somebody else may have put it there."""
    return _opened(path, flags, follow=False)


def read(path: str | os.PathLike[str]) -> bytes:
    """Return the content of a regular file.

    Raises:
        OSError: that of :func:`regular`.
    """
    with open(path, "rb", opener=regular) as file:
        return file.read()


def digest(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a regular file, in hexadecimal digits, without its content in memory.

    Raises:
        OSError: that of :func:`regular`, or the file is larger than a program that somebody wrote.
    """
    with open(path, "rb", opener=regular) as file:
        if os.fstat(file.fileno()).st_size > _LARGEST:
            # A sparse file has any size, and costs whoever makes it nothing.
            raise OSError(errno.EFBIG, "it is too large to be read", os.fspath(path))
        return hashlib.file_digest(file, "sha256").hexdigest()


def new_file(path: Path) -> BinaryIO:
    """Make a file that did not exist before, in place of whatever is there.

    Raises:
        OSError: it cannot be made, or a folder is in its place.
    """
    path.unlink(missing_ok=True)
    return open(path, "xb", opener=no_link)


def new_file_below(folder: str | os.PathLike[str], name: str) -> BinaryIO:
    """Make a file in a folder in which somebody else may have put a link, in place of whatever is there.

    Args:
        name: relative path; the folders in it are made where they are not there.

    Raises:
        OSError: it cannot be made, or a folder is in its place.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    with _room(folder, name) as (at, last):
        return os.fdopen(os.open(last, flags, 0o666, dir_fd=at), "wb")


def remove_below(folder: str | os.PathLike[str], name: str) -> None:
    """Have no file of a name in a folder in which somebody else may have put a link.

    Raises:
        OSError: that of :func:`new_file_below`.
    """
    with _room(folder, name):
        pass


def remove_tree(folder: str) -> None:
    """Remove a folder in which somebody else may have made anything, however deep, as far as that is possible; nobody writes there any more.

    What a folder holds is moved up before the folder is removed: the time grows with the number of files, and nothing with the depth.
    """
    with suppress(OSError):
        at = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            fresh = (f"otmcp-{number}" for number in count())
            removed = True
            while removed:
                removed = False
                for name in os.listdir(at):
                    removed |= _removed(name, at, fresh)
        finally:
            os.close(at)
        os.rmdir(folder)


def _removed(name: str, at: int, fresh: Iterator[str]) -> bool:
    """Remove a file, or a folder whose folders are moved up under fresh names; tell whether that was done."""
    with suppress(OSError):
        if not stat.S_ISDIR(os.stat(name, dir_fd=at, follow_symlinks=False).st_mode):
            os.unlink(name, dir_fd=at)
            return True
        os.chmod(name, stat.S_IRWXU, dir_fd=at)
        inner = os.open(name, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=at)
        try:
            for part in os.listdir(inner):
                if stat.S_ISDIR(os.stat(part, dir_fd=inner, follow_symlinks=False).st_mode):
                    # A folder that is moved is written to: it names the one above it.
                    os.chmod(part, stat.S_IRWXU, dir_fd=inner)
                    os.rename(part, _free(fresh, at), src_dir_fd=inner, dst_dir_fd=at)
                else:
                    os.unlink(part, dir_fd=inner)
        finally:
            os.close(inner)
        os.rmdir(name, dir_fd=at)
        return True
    return False


def _free(fresh: Iterator[str], at: int) -> str:
    return next(name for name in fresh if not _is_there(name, at))


def _is_there(name: str, at: int) -> bool:
    try:
        os.stat(name, dir_fd=at, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return True


@contextmanager
def _room(folder: str | os.PathLike[str], name: str) -> Iterator[tuple[int, str]]:
    """Remove what is at a path below a folder; yield a descriptor of where it was, and its last part."""
    *folders, last = Path(name).parts
    at = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        for part in folders:
            inner = _folder(part, at)
            os.close(at)
            at = inner
        with suppress(FileNotFoundError):
            os.unlink(last, dir_fd=at)
        yield at, last
    finally:
        os.close(at)


def _folder(name: str, at: int) -> int:
    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        return os.open(name, flags, dir_fd=at)
    except FileNotFoundError:
        pass
    except NotADirectoryError:
        # A link as well.
        os.unlink(name, dir_fd=at)
    os.mkdir(name, dir_fd=at)
    return os.open(name, flags, dir_fd=at)


def _opened(path: str | os.PathLike[str], flags: int, *, follow: bool) -> int:
    try:
        # A device is not even opened.
        _check(os.stat(path, follow_symlinks=follow), path)
    except FileNotFoundError:
        if not flags & os.O_CREAT:
            raise
    descriptor = os.open(path, flags | _WITHOUT_WAITING | (0 if follow else os.O_NOFOLLOW), 0o666)
    try:
        _check(os.fstat(descriptor), path)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _check(found: os.stat_result, path: str | os.PathLike[str]) -> None:
    if not stat.S_ISREG(found.st_mode):
        what = "a link" if stat.S_ISLNK(found.st_mode) else "a pipe, a socket, a device or a folder"
        raise OSError(errno.EINVAL, f"it is {what}, where a regular file should be", os.fspath(path))
