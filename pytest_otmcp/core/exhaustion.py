"""What the machine of the kit can run out of, and what helps. Pure.

Descriptors, memory, processes and disk belong to the kit and to whoever runs it; their end says nothing about an adapter.
"""

from __future__ import annotations

import errno

__all__ = ["exhausted"]

_CURES = {
    errno.EMFILE: "a process of the kit has no file descriptor left; raise the limit, for instance with `ulimit -n 1024`",
    errno.ENFILE: "this machine has no file descriptor left; end other programs, or raise fs.file-max",
    errno.ENOMEM: "this machine has no memory left; end other programs",
    errno.ENOBUFS: "this machine has no memory left for sockets; end other programs",
    errno.ENOSPC: "the disk is full; make room, or choose other directories with --otmcp-report-dir and TMPDIR",
    errno.EDQUOT: "the quota of the disk is used up; make room, or choose other directories with --otmcp-report-dir and TMPDIR",
    errno.EFBIG: "a file would be larger than this process may write; raise the limit, for instance with `ulimit -f unlimited`",
    errno.EAGAIN: "no further process or thread may be started; end other programs, or raise `ulimit -u`",
}
_NO_THREAD = "can't start new thread"
"""All that Python says when the system refuses a thread."""


def exhausted(error: BaseException) -> str | None:
    """Say what the machine has run out of, and what helps; None for an error of another kind."""
    if isinstance(error, BaseExceptionGroup):
        return next((found for inner in error.exceptions if (found := exhausted(inner)) is not None), None)
    if isinstance(error, MemoryError):
        return _CURES[errno.ENOMEM]
    if isinstance(error, RuntimeError) and str(error) == _NO_THREAD:
        return _CURES[errno.EAGAIN]
    return _CURES.get(error.errno or 0) if isinstance(error, OSError) else None
