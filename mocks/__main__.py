"""``python -m pytest_otmcp.mocks PROTOCOL``: start a mock device by hand or from the kit."""

from __future__ import annotations

import argparse
import os
import sys

from .launcher import run

PROTOCOLS = ("modbus", "mqtt", "opcua")


def main() -> int:
    """Parse the command line and run the launcher."""
    parser = argparse.ArgumentParser(prog="python -m pytest_otmcp.mocks", description=__doc__)
    parser.add_argument("protocol", choices=(*PROTOCOLS, "sparkplug"))
    parser.add_argument("--host", default="127.0.0.1", help="address to serve on (default: %(default)s)")
    parser.add_argument("--port", type=int, default=0, help="port to serve on (default: a free one)")
    parser.add_argument("--broker", metavar="URL", help="mqtt://host:port that the edge node of sparkplug joins")
    options = parser.parse_args()
    if (options.broker is not None) != (options.protocol == "sparkplug"):
        parser.error("--broker: sparkplug needs it, the other mocks do not take it")
    if options.protocol == "sparkplug":
        return _simulate(parser, options.broker)
    if not 0 <= options.port <= 65535:
        parser.error(f"--port: expected 0 to 65535, found {options.port}")
    if not hasattr(os, "fork"):
        print("the mock devices need os.fork, which this platform does not have", file=sys.stderr)
        return 1
    try:
        return run(options.protocol, options.host, options.port)
    except OSError as error:
        print(f"cannot serve on {options.host}:{options.port}: {error.strerror or error}", file=sys.stderr)
        return 1


def _simulate(parser: argparse.ArgumentParser, broker: str) -> int:
    from .mqtt import standalone  # the other mocks need not load it

    try:
        return standalone.run(broker)
    except ValueError as error:
        parser.error(f"--broker: {error}")
    except OSError as error:
        print(f"cannot join {broker}: {error.strerror or error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
