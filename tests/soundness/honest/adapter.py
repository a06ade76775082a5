"""One honest adapter: run as ``python adapter.py GROUP/NAME``."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

from pytest_otmcp.reference_adapters.core.run import serve

sys.path.insert(0, str(Path(__file__).parents[3]))


def main() -> None:
    from tests.soundness.honest.zoo import ZOO

    choice = ZOO[sys.argv[1]]
    server = import_module(f"pytest_otmcp.reference_adapters.{choice.protocol}").build()
    choice.change(server)
    sys.exit(serve(server))


if __name__ == "__main__":
    main()
