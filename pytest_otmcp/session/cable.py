"""The question whether this machine allows a cable between a device and its adapters."""

from __future__ import annotations

import subprocess
import sys
from functools import cache

from .isolation import remedy

__all__ = ["cable_refused"]

_PATIENCE_S = 60.0


@cache
def cable_refused() -> str | None:
    """Make a cable and give it up again; say what this machine refuses, and what helps. None where it allows a cable."""
    program = [sys.executable, "-P", "-m", "pytest_otmcp.mocks.cable"]
    tried = subprocess.run(program, capture_output=True, text=True, timeout=_PATIENCE_S, check=False)
    if tried.returncode == 0:
        return None
    told = tried.stderr.strip().splitlines() or ["no cable can be made"]
    return f"{told[-1]}; {remedy('in a container, `podman run --privileged` or `docker run --privileged` allows it')}"
