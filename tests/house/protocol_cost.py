"""Counts what a protocol costs: the lines of Python and TOML in files that bear its name, by where they lie.

``python -m tests.house.protocol_cost`` prints a row for each protocol of the kit.
"""

from __future__ import annotations

import shutil
import subprocess
from collections import Counter
from pathlib import Path

from pytest_otmcp.protocols.own import OWN

__all__ = ["cost"]

_CHECKOUT = Path(__file__).parents[2]
_ROOMS = ("pytest_otmcp/wire", "pytest_otmcp", "mocks", "reference_adapters", "conformance", "tests")
_ALSO = {"mqtt": ("sparkplug",)}
"""Further names of what belongs to a protocol."""


def cost(key: str) -> Counter[str]:
    """Return the lines of a protocol by room."""
    names = (key, *_ALSO.get(key, ()))
    git = shutil.which("git") or "git"
    listed = subprocess.run(
        [git, "ls-files", "*.py", "*.toml"], cwd=_CHECKOUT, check=True, capture_output=True, text=True
    )
    lines: Counter[str] = Counter()
    for name in listed.stdout.splitlines():
        room = next((room for room in _ROOMS if name.startswith(f"{room}/")), None)
        if room is not None and any(key in part for part in Path(name).parts for key in names):
            lines[room] += len((_CHECKOUT / name).read_text(encoding="utf-8").splitlines())
    return lines


def main() -> None:
    """Print the table."""
    print(f"{'':12}" + "".join(f"{room.rpartition('/')[2]:>20}" for room in _ROOMS) + f"{'sum':>8}")
    for key in OWN:
        lines = cost(key)
        print(f"{key:12}" + "".join(f"{lines[room]:20}" for room in _ROOMS) + f"{lines.total():8}")


if __name__ == "__main__":
    main()
