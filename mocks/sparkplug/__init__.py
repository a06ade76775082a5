"""The Sparkplug B edge node of the MQTT mock alone, as a client of a broker that is there already."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from .simulator import broker_address, run

__all__ = ["main"]


def main(arguments: Sequence[str]) -> int:
    """Run the simulator and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m pytest_otmcp.mocks sparkplug", description=__doc__)
    parser.add_argument("--broker", metavar="URL", required=True, help="mqtt://host:port that the edge node joins")
    url = parser.parse_args(arguments).broker
    try:
        host, port = broker_address(url)
    except ValueError as error:
        parser.error(f"--broker: {error}")
    try:
        return run(host, port)
    except OSError as error:
        print(f"cannot join {url}: {error.strerror or error}", file=sys.stderr)
        return 1
