"""``python program.py ID``: the reference adapter with the defect of this id."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

# The declarations are a part of the tests, which are not installed.
sys.path.insert(1, str(Path(__file__).parents[3]))

from pytest_otmcp.reference_adapters.core.run import serve

from tests.soundness.mutants.table import MUTANTS


def main() -> None:
    """Build the adapter, give it its defect, and serve."""
    mutant = MUTANTS[sys.argv[1]]
    server = import_module(f"pytest_otmcp.reference_adapters.{mutant.protocol}").build()
    mutant.bend(server)
    sys.exit(serve(server))


if __name__ == "__main__":
    main()
