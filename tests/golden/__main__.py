"""The command ``python -m tests.golden make [NAME…]``: make golden records, all or those with these names."""

from __future__ import annotations

import argparse
import fnmatch
import sys
import time

from pytest_otmcp.core.errors import KitError
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.warm_start import WarmStart

from .files import COMMAND, path_of
from .making import UnusableError, make
from .recipes import Recipe, recipes


def main() -> int:
    """Make the records of the command line, one after another, over one plant; return 1 when one could not be made."""
    parser = argparse.ArgumentParser(prog=COMMAND.removesuffix(" make"), description=__doc__)
    make_ = parser.add_subparsers(required=True, metavar="COMMAND").add_parser("make", help="make golden records")
    make_.add_argument("name", metavar="NAME", nargs="*", help="of a record; reference-* for several; without any, all")
    chosen = _chosen(parser, parser.parse_args().name)
    loop, plant, warm = LoopThread(), Plant(), WarmStart()
    try:
        made = [_made(loop, plant, warm, recipe) for recipe in chosen]
        return int(not all(made))
    finally:
        loop.run(plant.close())
        loop.close()
        warm.close()


def _chosen(parser: argparse.ArgumentParser, names: list[str]) -> list[Recipe]:
    for name in names:
        if not fnmatch.filter(recipes(), name):
            parser.error(f"there is no golden record {name!r}; there are {' '.join(recipes())}")
    return [recipe for known, recipe in recipes().items() if any(fnmatch.fnmatch(known, name) for name in names or "*")]


def _made(loop: LoopThread, plant: Plant, warm: WarmStart, recipe: Recipe) -> bool:
    begun = time.monotonic()
    try:
        size = make(loop, plant, warm, recipe)
    except (UnusableError, KitError) as error:
        print(f"{recipe.name}: not made: {error}", flush=True)
        return False
    kept = path_of(recipe.name).stat().st_size
    print(
        f"{recipe.name}: {len(recipe.items)} items in {time.monotonic() - begun:.0f} s, "
        f"{size / 1000:.0f} kB, {kept / 1000:.0f} kB compressed",
        flush=True,
    )
    return True


if __name__ == "__main__":
    sys.exit(main())
