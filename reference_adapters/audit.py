"""``python -m pytest_otmcp.reference_adapters.audit verify FILE… [--anchor ID…]``: verify an audit log, see ``chain``.

FILE is the log, or its parts in their order. ID is a ``meta.audit_id``. The exit code is 0 for a whole log, 1 for any other.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from .chain import Broken, verify


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, or these arguments, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m pytest_otmcp.reference_adapters.audit", description="Audit logs.")
    command = parser.add_subparsers(required=True).add_parser("verify", help="tell whether a log is whole")
    command.add_argument("files", nargs="+", type=Path, metavar="FILE", help="the log, or its parts in their order")
    command.add_argument("--anchor", nargs="+", default=[], metavar="ID", help="meta.audit_id of an answer")
    options = parser.parse_args(arguments)
    try:
        with ExitStack() as stack:
            found = verify([stack.enter_context(file.open("rb")) for file in options.files], options.anchor)
    except (Broken, OSError) as error:
        print(f"not whole: {error}", file=sys.stderr)
        return 1
    print(f"whole: records {found.first} to {found.last}; the last is {found.anchor}")
    if found.first > 1:
        print(f"records 1 to {found.first - 1} are in earlier files")
    if found.unfinished:
        print(f"{found.unfinished} bytes at the end are a record that was not finished")
    return 0


if __name__ == "__main__":
    sys.exit(main())
