"""The run records that the console was given, their reports, and the comparison of two.

The reports are written below a folder of the console's own, by the command's function for that, which examines a record in a process of
its own. A page of a report is reached by an address with a secret in it, because a browser that opens a page sends no token; it may run
nothing, whatever the record says.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path

from ..core.errors import UsageError
from .feed import Event

__all__ = ["POLICY", "Records", "Render"]

Render = Callable[[Sequence[Path], Path], Sequence[str]]
"""Writes the report of a record, or the comparison of several, below a directory, and returns what there is to say."""

POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
"""Content-Security-Policy of a report: without scripts, forms and requests, and not of the console's origin."""

_SECRET_BYTES = 24


class Records:
    """Run records by number.

    Args:
        paths: of the records.
        directory: for reports.
        render: writes them.
    """

    def __init__(self, paths: Sequence[Path], directory: Path, render: Render) -> None:
        self._paths = list(paths)
        self._directory = directory
        self._render = render

    def add(self, path: Path) -> None:
        """Take a record in, unless it is known."""
        if path not in self._paths:
            self._paths.append(path)

    def listed(self) -> Event:
        """Return the records for the page; one that is gone has no time."""
        listed = [{"record": n, "name": str(path), "written": _written(path)} for n, path in enumerate(self._paths)]
        return {"kind": "records", "records": listed}

    async def open(self, numbers: Sequence[int]) -> dict[str, object]:
        """Write the report of one record, or the comparison of several; return what there is to say, and the address of the page.

        Raises:
            UsageError: there is no such record.
        """
        if not numbers or any(number not in range(len(self._paths)) for number in numbers):
            raise UsageError("choose a record for its report, or several to compare them")
        secret = secrets.token_urlsafe(_SECRET_BYTES)
        paths = [self._paths[number] for number in numbers]
        said = await asyncio.to_thread(self._render, paths, self._directory / secret)
        return {"said": list(said), "page": f"/report/{secret}/{'comparison' if paths[1:] else 'report'}.html"}

    def page(self, secret: str, name: str) -> Path | None:
        """Return the file of a report's page; None where there is none."""
        known = {folder.name for folder in self._directory.iterdir()} if self._directory.is_dir() else set()
        if secret not in known or name not in ("report.html", "comparison.html"):
            return None
        path = self._directory / secret / name
        return path if path.is_file() else None


def _written(path: Path) -> str:
    try:
        return datetime.fromtimestamp(path.stat().st_mtime).astimezone().strftime("%Y-%m-%d %H:%M")
    except OSError:
        return ""
