"""The command ``otmcp`` in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

__all__ = ["OTMCP", "otmcp", "sentence"]

OTMCP = [sys.executable, "-P", "-m", "pytest_otmcp.cli"]

Done = subprocess.CompletedProcess[str]


def otmcp(*arguments: str, cwd: Path, environment: dict[str, str] | None = None) -> Done:
    """Run the command in a directory."""
    return subprocess.run(
        [*OTMCP, *arguments],
        cwd=cwd,
        env=os.environ | (environment or {}),
        capture_output=True,
        text=True,
        timeout=1800,
        check=False,
    )


def sentence(done: Done) -> str:
    """Return the one sentence on standard error."""
    lines = [line for line in done.stderr.splitlines() if line.startswith("otmcp: ")]
    assert len(lines) == 1, done.stderr
    assert "Traceback" not in done.stderr
    return lines[0]
