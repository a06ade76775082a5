"""Defects of an adapter's start, of its connections, and of its end."""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import socket
import sys
import time
from typing import Any

from ..core import AdapterError, AdapterServer, Call
from .mutant import Data, Handler, Mutant, each, failing

__all__ = ["MUTANTS", "exits_without_a_device"]


def address_of(server: AdapterServer) -> tuple[str, int]:
    """Return host and port of the adapter's device."""
    host, _, port = server.endpoint.partition("://")[2].rpartition(":")
    return host, int(port)


def exits_without_a_device(server: AdapterServer) -> None:
    try:
        socket.create_connection(address_of(server)).close()
    except OSError:
        sys.exit("there is no device")


def connection_per_call(server: AdapterServer) -> None:
    held = []

    def connecting(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            with contextlib.suppress(OSError):
                held.append(await asyncio.open_connection(*address_of(server)))
            data: Data = await genuine(call, arguments)
            return data

        return handler

    each("read_input_registers", change=connecting)(server)


def stays_with_writes_disabled(server: AdapterServer) -> None:
    if not server.writes_enabled:
        atexit.register(time.sleep, 60)


def _always_a_timeout(call: Call, error: AdapterError) -> Exception | None:
    lost = error.code in ("connect_failed", "connection_lost")
    return AdapterError("timeout", "the device does not answer") if lost else None


MUTANTS = (
    Mutant(
        id="MU-51",
        protocol="modbus",
        sentence="The adapter does not start while its device is off.",
        bend=exits_without_a_device,
        items="R-modbus",
        requirements="MCP-002",
        recovers=True,
    ),
    Mutant(
        id="MU-52r",
        protocol="modbus",
        sentence="With writes disabled the process does not exit when its stdin ends.",
        bend=stays_with_writes_disabled,
        items="M4",
        requirements="MCP-009",
        waits=True,
    ),
    Mutant(
        id="MU-90",
        protocol="modbus",
        sentence="Every call makes a connection and leaves it open.",
        bend=connection_per_call,
        items="S7",
        requirements="CON-006",
    ),
    Mutant(
        id="MU-120",
        protocol="modbus",
        sentence="A refused, a reset and a silent connection have one code.",
        bend=failing(change=_always_a_timeout),
        items="S10",
        requirements="ERR-005",
    ),
)
