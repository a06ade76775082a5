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
from .defect import Data, Handler, around, defect, failing

__all__ = ["DEFECTS", "exits_without_a_device"]


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

    @around("read_input_registers")
    async def connecting(genuine: Handler, call: Call, arguments: Any) -> Data:
        with contextlib.suppress(OSError):
            held.append(await asyncio.open_connection(*address_of(server)))
        data = await genuine(call, arguments)
        return data

    connecting(server)


def stays_with_writes_disabled(server: AdapterServer) -> None:
    if not server.writes_enabled:
        atexit.register(time.sleep, 60)


def _always_a_timeout(call: Call, error: AdapterError) -> Exception | None:
    lost = error.code in ("connect_failed", "connection_lost")
    return AdapterError("timeout", "the device does not answer") if lost else None


DEFECTS = (
    defect(
        "MU-51",
        "modbus",
        "The adapter does not start while its device is off.",
        exits_without_a_device,
        "R-modbus",
        "MCP-002",
        recovers=True,
    ),
    defect(
        "MU-52r",
        "modbus",
        "With writes disabled the process does not exit when its stdin ends.",
        stays_with_writes_disabled,
        "M4",
        "MCP-009",
        waits=True,
    ),
    defect(
        "MU-90", "modbus", "Every call makes a connection and leaves it open.", connection_per_call, "S7", "CON-006"
    ),
    defect(
        "MU-120",
        "modbus",
        "A refused, a reset and a silent connection have one code.",
        failing(change=_always_a_timeout),
        "S10",
        "ERR-005",
    ),
)
