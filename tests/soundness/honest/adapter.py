"""One honest adapter: run as ``python adapter.py GROUP/NAME``."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

from pytest_otmcp.reference_adapters.core.run import serve

sys.path.insert(0, str(Path(__file__).parents[3]))


def main() -> None:
    group, _, name = sys.argv[1].partition("/")
    # The whole zoo would import the library of each protocol, which takes longer than all the rest of a warm start.
    choice = import_module(f"tests.soundness.honest.{group}_choices").CHOICES[name]
    server = import_module(f"pytest_otmcp.reference_adapters.{choice.protocol}").build()
    choice.change(server)
    sys.exit(serve(server))


if __name__ == "__main__":
    main()
