"""A reference adapter that puts something else in the place of its audit log: run as ``python log_elsewhere.py link|pipe|second-name``.

The kit changes the log to see whether the verifier notices, with its own rights.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any

from pytest_otmcp.reference_adapters import modbus
from pytest_otmcp.reference_adapters.core import audit
from pytest_otmcp.reference_adapters.core.run import serve

REPLACED: dict[str, Callable[[str, str], None]] = {
    "link": os.symlink,
    "second-name": os.link,
    "pipe": lambda victim, log: os.mkfifo(log),
}
VICTIM = "victim.txt"
"""Beside the log, in the folder that the adapter may write: the walls keep it from others."""
CONTENT = b"not to be changed\n"


def main() -> None:
    genuine = audit.Audit.begin

    def begin(self: Any) -> None:
        genuine(self)
        victim = os.path.join(os.environ["VICTIM_FOLDER"], VICTIM)
        with open(victim, "wb") as file:
            file.write(CONTENT)
        log = str(self._path)
        os.unlink(log)
        REPLACED[sys.argv[1]](victim, log)

    audit.Audit.begin = begin  # type: ignore[method-assign]
    audit.Audit._is_there = lambda self: self._file is not None  # type: ignore[method-assign]
    sys.exit(serve(modbus.build()))


if __name__ == "__main__":
    main()
