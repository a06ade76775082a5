"""A device that cannot accept connections any more ends, and says so: its silence would be held against the adapter."""

from __future__ import annotations

import asyncio
import errno
import os
import sys
from typing import Any

__all__ = ["EXIT_CODE", "end_when_exhausted", "is_exhaustion"]

EXIT_CODE = 75
"""Exit code of a launcher or device that has run out of something: EX_TEMPFAIL of ``sysexits.h``."""

_EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM, errno.EAGAIN)


def is_exhaustion(error: object) -> bool:
    """Tell whether an error says that there are no descriptors, processes or memory left."""
    return isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno in _EXHAUSTED)


def end_when_exhausted(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Handle what no task of the loop has handled; asyncio itself would try to accept once more a second later."""
    error = context.get("exception")
    if is_exhaustion(error):
        print(f"the device ends: {error}", file=sys.stderr, flush=True)
        # Not sys.exit: tidying up takes what there is none of.
        os._exit(EXIT_CODE)
    loop.default_exception_handler(context)
