"""A device that cannot accept connections any more ends, loudly: its silence would be held against the adapter."""

from __future__ import annotations

import asyncio
import errno
import os
import sys
from typing import Any

__all__ = ["EXIT_CODE", "end_when_exhausted"]

EXIT_CODE = 75
"""Exit code of a device that ended so: EX_TEMPFAIL of ``sysexits.h``."""

_EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)


def end_when_exhausted(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Handle what no task of the loop has handled; asyncio itself would try to accept once more a second later."""
    error = context.get("exception")
    if isinstance(error, OSError) and error.errno in _EXHAUSTED:
        print(f"the device ends: {error.strerror}", file=sys.stderr, flush=True)
        # Not sys.exit: whatever would tidy up needs what there is none of.
        os._exit(EXIT_CODE)
    loop.default_exception_handler(context)
