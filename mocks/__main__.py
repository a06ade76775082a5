"""``python -m pytest_otmcp.mocks PROTOCOL``: start a mock device by hand or from the kit."""

from __future__ import annotations

import argparse
import gc
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from .exhaustion import EXIT_CODE, is_exhaustion
from .launcher import run
from .namespaces import enter_new, join
from .packages import MockPackage, built_in, load

_PROGRAM = "python -m pytest_otmcp.mocks"
_PORTLESS = {"pty": "pseudo terminal", "cable": "cable"}


def main() -> int:
    """Find the mock that the command line names, and run it."""
    parser = argparse.ArgumentParser(
        prog=_PROGRAM, description=__doc__, epilog=f"The options of a mock: {_PROGRAM} PROTOCOL --help"
    )
    known = ", ".join(built_in())
    parser.add_argument("--within", metavar="USER,NETWORK", help=argparse.SUPPRESS)
    parser.add_argument("protocol", metavar="PROTOCOL", help=f"{known}, or the dotted name of a module with a mock")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="OPTION", help="an option of this mock")
    options = parser.parse_args()
    if options.within:
        join(*map(int, options.within.split(",")))
    # The collector would search everything that is built now again and again and find nothing; this would be half of
    # the time that the building takes.
    gc.disable()
    try:
        package = load(options.protocol)
    except ValueError as error:
        parser.error(str(error))
    if hasattr(package, "main"):
        gc.enable()
        return package.main(options.arguments)
    return _launch(options.protocol, package, options.arguments, within=bool(options.within))


def _launch(name: str, package: MockPackage, arguments: Sequence[str], *, within: bool) -> int:
    parser = argparse.ArgumentParser(prog=f"{_PROGRAM} {name}", description=package.__doc__)
    parser.add_argument("--host", default="127.0.0.1", help="address to serve on (default: %(default)s)")
    parser.add_argument("--port", type=int, default=0, help="port to serve on (default: a free one)")
    parser.add_argument("--tls", type=Path, metavar="FOLDER", help="speak TLS with the certificates of a folder")
    options = parser.parse_args(arguments)
    if not 0 <= options.port <= 65535:
        parser.error(f"--port: expected 0 to 65535, found {options.port}")
    if options.port and (place := _PORTLESS.get(package.ENDPOINTS[0].kind)):
        parser.error(f"--port: {name} serves on a {place}, which has none")
    if not hasattr(os, "fork"):
        print("the mock devices need os.fork, which this platform does not have", file=sys.stderr)
        return 1
    cable = any(endpoint.kind == "cable" for endpoint in package.ENDPOINTS)
    try:
        if cable and not within:
            enter_new()
        return run(name, package, options.host, options.port, options.tls)
    except ValueError as error:
        parser.error(f"--tls: {error}")
    except OSError as error:
        where = f"a cable: this machine refuses {error.filename}" if cable else f"{options.host}:{options.port}"
        print(f"cannot serve on {where}: {error.strerror or error}", file=sys.stderr)
        return EXIT_CODE if is_exhaustion(error) else 1


if __name__ == "__main__":
    sys.exit(main())
