"""The files of the golden records."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["COMMAND", "FOLDER", "MACHINE_PATH", "names", "path_of"]

COMMAND = "python -m tests.golden make"

FOLDER = Path(__file__).parents[1] / "data" / "golden"

MACHINE_PATH = re.compile(r"/(?<![\w./:{}-]/)(?:home|root|work|tmp|var|usr|opt|Users|private)/[\w.+/-]*")
"""A path that tells something of the machine on which a record was made."""

_ENDING = ".json.gz"


def path_of(name: str) -> Path:
    """Return the file of the record with this name."""
    return FOLDER / f"{name}{_ENDING}"


def names() -> list[str]:
    """Return the names of the records that there are."""
    return sorted(path.name.removesuffix(_ENDING) for path in FOLDER.iterdir())
