"""``python -m pytest_otmcp.reference_adapters.approvals {list,approve,deny} INBOX [ID]``: answer what lies in an inbox, see ``core.approval``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from .core.approval import answered


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, or these arguments, and return the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m pytest_otmcp.reference_adapters.approvals", description="Writes that wait for a person."
    )
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="show what waits").add_argument("inbox", type=Path)
    for name in ("approve", "deny"):
        command = commands.add_parser(name, help=f"{name} a write")
        command.add_argument("inbox", type=Path)
        command.add_argument("id", help="as list shows it")
    options = parser.parse_args(arguments)
    try:
        if options.command == "list":
            for file in sorted(options.inbox.glob("*.request")):
                shown = json.loads(file.read_bytes())
                print(f"{file.stem} (until {shown['until']})\n{shown['text']}\n")
            return 0
        text = answered(options.inbox, options.id, approve=options.command == "approve")
    except (OSError, ValueError, KeyError) as error:
        print(f"no such request, or it is answered already: {error}", file=sys.stderr)
        return 1
    print(f"{options.command}:\n{text}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
