"""``otmcp mock``: a mock started by hand, for any client."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from typing import Any, NoReturn

from ..core.errors import UsageError
from ..protocols.protocol import Simulator
from ..protocols.registry import protocols
from . import show

__all__ = ["add_parser", "port", "run"]

_OPTIONS: Mapping[str, tuple[str, str]] = {
    "host": ("ADDRESS", "address to serve on (default: 127.0.0.1)"),
    "port": ("N", "port to serve on (default: a free one)"),
}
"""Options of every mock, each with a metavariable and its help text."""


def add_parser(subparsers: Any) -> None:
    """Declare the subcommand."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "mock",
        help="start a mock device by hand",
        description="Start a mock device. It prints one JSON line that says where it is, and serves until standard input closes.",
    )
    parser.add_argument("protocol", choices=tuple(_mocks()))
    for name, (metavar, text) in _options().items():
        parser.add_argument(f"--{name}", metavar=metavar, help=text, type=port if name == "port" else str)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> NoReturn:
    """Replace this process by the mock, which checks the values of its options itself.

    Raises:
        UsageError: the mock has no such option, or lacks one.
    """
    mock, clients = _mocks()[args.protocol]
    given = {option: value for option in _options() if (value := getattr(args, option)) is not None}
    _check(args.protocol, given)
    show(
        f"otmcp: a JSON line says where the {args.protocol} mock is as soon as it is ready; it is for {clients}. "
        "It ends with Ctrl-C, and when its standard input closes.",
        sys.stderr,
    )
    options = [f"--{option}={value}" for option, value in given.items()]
    # A module of the working directory must not take the place of a module of the mock.
    os.execv(sys.executable, [sys.executable, "-P", "-m", "pytest_otmcp.mocks", mock, *options])  # noqa: S606


def _check(name: str, given: Mapping[str, str | int]) -> None:
    """Refuse options that a mock does not have: it would speak of a program whose name nobody has typed.

    Raises:
        UsageError: it has another option, or lacks one.
    """
    simulator = _simulators().get(name)
    known = _OPTIONS if simulator is None else simulator.options
    for option in given.keys() - known.keys():
        raise UsageError(f"--{option}: the {name} mock has no such option; it has --{', --'.join(known)}")
    for option, (metavar, text) in () if simulator is None else simulator.options.items():
        if option not in given:
            raise UsageError(f"the {name} mock needs --{option} {metavar}: {text}")


def port(text: str) -> int:
    """Read the number of a port, as the type of an option."""
    if not (text.isascii() and text.isdigit() and int(text) <= 65535):
        raise argparse.ArgumentTypeError(f"expected 0 to 65535, found {text!r}")
    return int(text)


def _mocks() -> dict[str, tuple[str, str]]:
    """Return, by the name that the user gives, each mock's name in ``mocks`` and the clients that it is for."""
    devices = {key: (protocol.mock, protocol.clients) for key, protocol in protocols().items()}
    return devices | {name: (name, simulator.clients) for name, simulator in _simulators().items()}


def _simulators() -> dict[str, Simulator]:
    return {name: simulator for protocol in protocols().values() for name, simulator in protocol.simulators.items()}


def _options() -> dict[str, tuple[str, str]]:
    return {**_OPTIONS, **{name: text for one in _simulators().values() for name, text in one.options.items()}}
