"""``python -m pytest_otmcp.reference_adapters PROTOCOL``: run a reference adapter, configured by its environment.

A reference adapter is a sub-package with a module ``adapter`` that offers ``build``.
"""

from __future__ import annotations

import gc
import os
import sys

# The search for pydantic plugins in the metadata of every installed distribution costs 40 ms of a start.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
# Most of the start is imports, and most garbage collections during imports find nothing (measured: 70 ms of 710).
gc.disable()

from importlib import import_module
from pathlib import Path

from .core.run import serve
from .core.settings import ConfigError


def main() -> int:
    """Run the adapter that the command line names and return the exit code."""
    # Adapters are found by their files: importing every protocol's library only to list them takes longer than a start.
    protocols = sorted(file.parent.name for file in Path(__file__).parent.glob("*/adapter.py"))
    if len(sys.argv) != 2 or sys.argv[1] not in protocols:
        print(f"usage: python -m pytest_otmcp.reference_adapters {{{'|'.join(protocols)}}}", file=sys.stderr)
        return 2
    adapter = import_module(f".{sys.argv[1]}.adapter", __package__)
    try:
        server = adapter.build()
    except ConfigError as error:
        print(f"configuration: {error}", file=sys.stderr)
        return 2
    gc.enable()
    return serve(server)


if __name__ == "__main__":
    sys.exit(main())
