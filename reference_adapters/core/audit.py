"""The audit log: JSON Lines that are on disk before what they tell of leaves, chained by hashes over their bytes (``chain``).

Whatever is wrong with the file (full disk, no permission, another process has it), what would have to be recorded does not happen, and everything
else goes on. The next record is tried again from the beginning: the file is opened and its end is read.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import sys
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ..chain import START, Broken, Record, records
from .errors import AdapterError
from .settings import Environment

__all__ = ["Audit"]

_WINDOW = 1 << 16
_SYNC = getattr(os, "fdatasync", os.fsync)


class Audit:
    """A log that is only appended to.

    Args:
        path: the file; its folder must exist. Beside it is ``PATH.lock``, which one process has.
        most_bytes: size from which the file is renamed to ``PATH.NUMBER``, after its last record, and the chain goes on in a new one. None for no
            limit.
        about: members of the record ``start``.
    """

    def __init__(self, path: Path, most_bytes: int | None, about: dict[str, Any]) -> None:
        self._path = path
        self._most_bytes = most_bytes
        self._about = about
        self._file: int | None = None
        self._lock: int | None = None
        self._size = self._inode = 0
        self._seq, self._hash = 0, START
        self._missed = 0
        self._started = False

    @classmethod
    def of(cls, environment: Environment, about: dict[str, Any]) -> Audit | None:
        """Return the log that ``OT_AUDIT_LOG`` names; ``OT_AUDIT_ROTATE_MB`` is its largest size, 0 for any (64).

        Raises:
            ConfigError: the size is not understood.
        """
        path = environment.optional("OT_AUDIT_LOG")
        if path is None:
            return None
        size = environment.whole("OT_AUDIT_ROTATE_MB", 64, 0, 1 << 20)
        return cls(Path(path), size << 20 or None, about)

    def append(self, event: str, **members: Any) -> str:
        """Append a record and return its anchor; the record is on disk then.

        Raises:
            AdapterError: ``audit_unavailable``.
        """
        try:
            self._prepare()
            return self._write(event, members)
        except (OSError, Broken) as error:
            self._forget()
            self._missed += 1
            reason = error.strerror if isinstance(error, OSError) else str(error)
            print(f"audit log {self._path}: {reason}", file=sys.stderr, flush=True)
            message = f"the write cannot be recorded in the audit log, so it is not done: {reason}"
            raise AdapterError("audit_unavailable", message, outcome="not_sent") from None

    def begin(self) -> None:
        """Begin the log, where that is possible now."""
        try:
            self._prepare()
        except (OSError, Broken) as error:
            self._forget()
            print(f"audit log {self._path}: {error}; nothing is written until that is mended", file=sys.stderr)

    def _prepare(self) -> None:
        if not self._is_there():
            # Not yet, not after a failure, or somebody has taken the file away.
            self._forget()
            self._open()
        elif self._most_bytes is not None and self._size >= self._most_bytes:
            self._rotate()

    def close(self) -> None:
        """Append the last record, where that is possible."""
        if self._started:
            with suppress(AdapterError):
                self.append("stop")
        self._forget()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _forget(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _open(self) -> None:
        if self._lock is None:
            lock = os.open(f"{self._path}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(lock)
                raise Broken("another process writes it") from None
            self._lock = lock
        # To open a pipe is to wait for whoever reads it; what is written to a device is gone.
        if self._path.exists() and not self._path.is_file():
            raise Broken("it is no file")
        last, lost, whole_lines = _end(self._path) if self._path.exists() else (None, 0, True)
        continues = last is None
        if last is None and not self._started:
            last = self._end_before()
        if last is not None and last.seq < self._seq:
            raise Broken("records at its end have been removed")
        if last is not None:
            self._seq, self._hash = last.seq, last.hash
        self._create()
        if not whole_lines:
            self._raw(b"\n")
        if (continues and self._seq) or lost or self._missed:
            what = {"lost_bytes": lost, "unrecorded": self._missed}
            self._write("continued" if continues and self._seq else "recovered", what)
            self._missed = 0
        if not self._started:
            self._write("start", self._about)
            self._started = True

    def _create(self) -> None:
        self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
        found = os.fstat(self._file)
        self._size, self._inode = found.st_size, found.st_ino
        if not self._size:
            # A new file is on disk when its name is.
            folder = os.open(self._path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)

    def _is_there(self) -> bool:
        try:
            return self._file is not None and os.stat(self._path).st_ino == self._inode
        except FileNotFoundError:
            return False

    def _end_before(self) -> Record | None:
        """Return the last record of the newest file that was renamed."""
        renamed = re.compile(re.escape(self._path.name) + r"\.(\d+)")
        older = {int(found[1]): file for file in self._path.parent.iterdir() if (found := renamed.fullmatch(file.name))}
        return _end(older[max(older)])[0] if older else None

    def _rotate(self) -> None:
        os.rename(self._path, f"{self._path}.{self._seq:09}")
        self._forget()
        self._create()
        self._write("continued", {"lost_bytes": 0, "unrecorded": 0})

    def _write(self, event: str, members: dict[str, Any]) -> str:
        time = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        record = {"seq": self._seq + 1, "time": time, "event": event, **members, "prev": self._hash}
        # In ASCII, with every line break escaped, no text of an argument can look like the end of a record.
        body = json.dumps(record, ensure_ascii=True, allow_nan=False, separators=(",", ":")).encode()[:-1]
        digest = hashlib.sha256(body).hexdigest()
        self._raw(body + b',"hash":"' + digest.encode() + b'"}\n')
        self._seq, self._hash = self._seq + 1, digest
        return f"{self._seq}:{digest[:16]}"

    def _raw(self, data: bytes) -> None:
        assert self._file is not None
        written = os.write(self._file, data)
        self._size += written
        if written != len(data):
            raise Broken("the file takes no more, its disk is full or its size is limited")
        _SYNC(self._file)


def _end(path: Path) -> tuple[Record | None, int, bool]:
    """Return the last record of a file, the bytes after it that are none, and whether the file ends with a line break.

    Raises:
        Broken: there are lines, and none is a record.
    """
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        window = _WINDOW
        while True:
            start = max(0, size - window)
            file.seek(start)
            *lines, tail = file.read(size - start).split(b"\n")
            if start:
                # The first is the rest of a line.
                lines = lines[1:]
            lost, last = len(tail), None
            for last, line in records(reversed(lines)):
                if last is not None:
                    break
                lost += len(line)
            if last is not None or not start:
                if last is None and lines:
                    raise Broken("it is no audit log, or its first record is damaged")
                return last, lost, not tail
            window *= 8
