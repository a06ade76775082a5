"""``otmcp mock``: a mock device started by hand, for any client to be pointed at."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Any, NoReturn

__all__ = ["add_parser", "run"]

_CLIENTS = {
    "modbus": "a Modbus TCP client with unit identifier 1",
    "mqtt": "an MQTT client, version 3.1.1 or 5",
    "opcua": "an OPC UA client with security None",
    "sparkplug": "an MQTT client at the broker",
}


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "mock",
        help="start a mock device by hand",
        description="Start a mock device. It prints one JSON line that says where it is, and serves until standard input closes.",
    )
    parser.add_argument("protocol", choices=tuple(_CLIENTS))
    parser.add_argument("--host", metavar="ADDRESS", help="address to serve on (default: 127.0.0.1)")
    parser.add_argument("--port", metavar="N", help="port to serve on (default: a free one)")
    parser.add_argument("--broker", metavar="URL", help="mqtt://host:port that the edge node of sparkplug joins")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> NoReturn:
    """Become the mock; it checks its options itself."""
    options = [f"--{name}={value}" for name in ("host", "port", "broker") if (value := getattr(args, name)) is not None]
    print(
        f"otmcp: the JSON line below says where the {args.protocol} mock serves; point {_CLIENTS[args.protocol]} at it. "
        "It ends with Ctrl-C, and when its standard input closes.",
        file=sys.stderr,
        flush=True,
    )
    # A module of the directory that this was called in must not stand in for one of the mock's.
    os.execv(sys.executable, [sys.executable, "-P", "-m", "pytest_otmcp.mocks", args.protocol, *options])  # noqa: S606
