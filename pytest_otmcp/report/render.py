"""Makes every report from a run record, and says where they are."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from ..record import RecordError, load
from .console import summary
from .figures import write_figures
from .latex import write_tables

__all__ = ["render"]

_MARKUP = {"ok": {"green": True, "bold": True}, "bad": {"red": True, "bold": True}, "head": {"bold": True}, "plain": {}}


def render(path: Path, terminal: Any, root: Path) -> None:
    """Write tables and figures beside ``path`` and the summary to pytest's terminal."""
    try:
        run = load(path, allow_incomplete=True)
    except RecordError as error:
        terminal.write_line(f"no reports were written: {error}", red=True)
        return
    begun = time.monotonic()
    write_tables(run, path.parent / "tables")
    write_figures(run, path.parent / "figures")
    seconds = time.monotonic() - begun
    for line, style in summary(run, width=terminal._tw.fullwidth):
        terminal.write_line(line, **_MARKUP[style])
    where = path.parent.relative_to(root) if path.is_relative_to(root) else path.parent
    terminal.write_line(f"run.json, tables/ and figures/ are in {where} (tables and figures took {seconds:.1f} s)")
