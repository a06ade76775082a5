"""The walls around the adapters that a command starts, and its option ``--isolation``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ..core.walls import AUTO, MODES, OFF, missing
from . import show

if TYPE_CHECKING:
    from ..session.isolation import Isolation

__all__ = ["add_option", "isolated"]


def add_option(parser: argparse.ArgumentParser) -> None:
    """Declare ``--isolation``."""
    parser.add_argument(
        "--isolation",
        choices=MODES,
        default=AUTO,
        help="walls around the adapters: as far as the machine allows (auto, the default), else nothing is started (require), or none (off)",
    )


@contextmanager
def isolated(args: argparse.Namespace) -> Iterator[Isolation]:
    """Give the isolation that was asked for; at the end say which wall was missing, and why.

    Raises:
        UsageError: walls are required, and the machine refuses one.
    """
    from ..session.isolation import Isolation

    isolation = Isolation(args.isolation)
    try:
        yield isolation
        if args.isolation != OFF:
            for sentence in missing(isolation.account()):
                show(sentence, sys.stderr)
    finally:
        isolation.close()
