"""Defects that the checks of the area KEY notice."""

from __future__ import annotations

import base64
import os
import socket
import subprocess
import sys

from ...core import AdapterError, AdapterServer, Call
from ..claims import meta
from ..defect import Change, Data, Defect, defect, failing
from ..life import address_of

__all__ = ["DEFECTS"]

_SPARE = "OTMCP_CANARY_TOKEN"
"""A variable of the adapter's environment that it has no use for."""
_LONGEST = 480
_BROKEN = ("connect_failed", "connection_lost", "timeout", "auth_failed")


def environment_in_errors(*codes: str) -> Change:
    """Return the defect that failures with these codes show the environment, cut off where a message must end."""

    def change(call: Call, error: AdapterError) -> Exception | None:
        shown = str(dict(os.environ))[:_LONGEST]
        return AdapterError(error.code, shown, outcome=error.outcome) if error.code in codes else None

    return failing(change=change)


def password_in_errors(call: Call, error: AdapterError) -> Exception | None:
    if error.code not in _BROKEN:
        return None
    account = f"{os.environ['MQTT_USERNAME']}:{os.environ['MQTT_PASSWORD']}"
    return AdapterError(error.code, f"no connection as {account}", outcome=error.outcome)


def account_in_the_trace(stated: Data) -> None:
    account = f"{os.environ['MQTT_USERNAME']}:{os.environ['MQTT_PASSWORD']}"
    stated["trace"] = {**stated["trace"], "authorization": f"Basic {base64.b64encode(account.encode()).decode()}"}


def settings_on_stderr(server: AdapterServer) -> None:
    for name, value in os.environ.items():
        print(f"{name}={value.encode().hex()}", file=sys.stderr)


def secret_for_a_helper(server: AdapterServer) -> None:
    waiting = "import sys; sys.stdin.read()"
    command = [sys.executable, "-S", "-c", waiting, f"--token={os.environ[_SPARE]}"]
    # The helper ends with the adapter, whose end closes the pipe.
    server.helper = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)


def secret_in_a_description(server: AdapterServer) -> None:
    listing = next(iter(server._tools.values())).listing
    listing.description = f"{listing.description} (configured by {dict(os.environ)})"


def ends_with_its_settings(server: AdapterServer) -> None:
    """End at the start, with everything that it was told, where there is no device."""
    try:
        socket.create_connection(address_of(server)).close()
    except OSError:
        sys.exit(f"there is no device; the settings are {dict(os.environ)}")


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-99b",
        "mqtt",
        "The password is in the words of an error.",
        failing(change=password_in_errors),
        "KEY-001",
        quick=True,
    ),
    defect(
        "MU-99c",
        "modbus",
        "The whole environment is in the words of an error.",
        environment_in_errors(*_BROKEN),
        "KEY-001",
    ),
    defect(
        "MU-99d",
        "mqtt",
        "Each answer has user name and password in base64, as HTTP would send them.",
        meta(account_in_the_trace),
        "KEY-001",
    ),
    defect(
        "MU-99e",
        "opcua",
        "At the start the environment is logged, its values in hexadecimal digits.",
        settings_on_stderr,
        "KEY-001",
    ),
    defect(
        "MU-99f",
        "modbus",
        "A secret is an argument of a process that the adapter starts.",
        secret_for_a_helper,
        "KEY-001",
        cold=True,
    ),
    defect("MU-99g", "s7", "The description of a tool has the environment in it.", secret_in_a_description, "KEY-001"),
    defect(
        "MU-99h",
        "modbus",
        "An adapter that does not start without its device ends with its environment on stderr.",
        ends_with_its_settings,
        "KEY-001",
        "KEY-001 MCP-002",
    ),
)
