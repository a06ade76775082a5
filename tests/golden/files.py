"""The files of the golden records."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from pytest_otmcp.record.reader import open_record

__all__ = ["COMMAND", "FOLDER", "MACHINE_PATH", "names", "path_of", "recorded"]

COMMAND = "python -m tests.golden make"

FOLDER = Path(__file__).parents[1] / "data" / "golden"

MACHINE_PATH = re.compile(r"/(?<![\w./:{}-]/)(?:home|root|work|tmp|var|usr|opt|Users|private)/[\w.+/-]*")
"""A path that tells something of the machine on which a record was made."""

_ENDING = ".json.gz"


def path_of(name: str) -> Path:
    """Return the file of the record with this name."""
    return FOLDER / f"{name}{_ENDING}"


def recorded(name: str) -> dict[str, Any]:
    """Read the record with this name into memory, with the entries that its journals show."""
    with open_record(path_of(name), compressed=True) as run:
        items = [{**item.head, "samples": list(item.samples())} for item in run.items()]
        return {**run.header, "items": items, "footer": run.footer}


def names() -> list[str]:
    """Return the names of the records that there are."""
    return sorted(path.name.removesuffix(_ENDING) for path in FOLDER.iterdir())
