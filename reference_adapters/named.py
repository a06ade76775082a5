"""``python -m pytest_otmcp.reference_adapters.named PROTOCOL``: a reference adapter with a vocabulary of its own.

Its tools have names such as ``set_brightness``, and take no register, node or topic. It is a sub-package's module ``named`` that offers ``build``.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

from .core.run import serve
from .core.settings import ConfigError


def main() -> int:
    """Run the adapter that the command line names and return the exit code."""
    protocols = sorted(file.parent.name for file in Path(__file__).parent.glob("*/named.py"))
    if len(sys.argv) != 2 or sys.argv[1] not in protocols:
        print(f"usage: python -m pytest_otmcp.reference_adapters.named {{{'|'.join(protocols)}}}", file=sys.stderr)
        return 2
    try:
        server = import_module(f".{sys.argv[1]}.named", __package__).build()
    except ConfigError as error:
        print(f"configuration: {error}", file=sys.stderr)
        return 2
    return serve(server)


if __name__ == "__main__":
    sys.exit(main())
