"""Defects of what an adapter says of its calls and tools, while it does what it is asked for."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from datetime import datetime

from ..core import AdapterServer, Call
from ..core import call as core_call
from .defect import Change, Data, defect

__all__ = [
    "DEFECTS",
    "bare_schema",
    "constant_latency",
    "invented_trace",
    "latency_in_seconds",
    "meta",
    "one_attempt",
]

_EVERY_ITEM = "M1 M2 M3 M4 X1 X2 X1p X2p FM1 FM2 FX1 S1 S4 S7 S10"


def meta(change: Callable[[Data], None]) -> Change:
    """Return the defect that every envelope says something else about its call."""

    def apply(server: AdapterServer) -> None:
        genuine = core_call.Call._meta

        def changed(call: Call) -> Data:
            stated = genuine(call)
            change(stated)
            return stated

        core_call.Call._meta = changed

    return apply


def one_attempt(stated: Data) -> None:
    stated["attempts"] = 1


def latency_in_seconds(stated: Data) -> None:
    stated["latency_ms"] = stated["latency_ms"] / 1000


def constant_latency(stated: Data) -> None:
    stated["latency_ms"] = 1.0


def default_endpoint(stated: Data) -> None:
    stated["endpoint"] = "modbus+tcp://127.0.0.1:502"


def invented_trace(stated: Data) -> None:
    if stated["trace"]:
        stated["trace"] |= {"unit": 99, "function": 1, "address": 4711}


def local_time(server: AdapterServer) -> None:
    os.environ["TZ"] = "Asia/Tokyo"
    time.tzset()

    def change(stated: Data) -> None:
        at = datetime.fromisoformat(stated["started_at"]).astimezone().replace(tzinfo=None)
        stated["started_at"] = at.isoformat(timespec="milliseconds") + "Z"

    meta(change)(server)


def bare_schema(server: AdapterServer) -> None:
    for tool in server._tools.values():
        tool.listing.input_schema = {"type": "object"}


def says_it_only_reads(server: AdapterServer) -> None:
    annotations = server._tools["write_register"].listing.annotations
    assert annotations is not None
    annotations.read_only_hint = True


DEFECTS = (
    defect("MU-26", "modbus", "attempts is always 1.", meta(one_attempt), "M4 FM1 FM2", "ENV-005"),
    defect(
        "MU-53h",
        "modbus",
        "The tool that writes a register has a readOnlyHint.",
        says_it_only_reads,
        "M3 M4 X2 X2p FM2 S4 S10",
        "MCP-008",
    ),
    defect("MU-59a", "modbus", "latency_ms is in seconds.", meta(latency_in_seconds), "M1", "ENV-004"),
    defect("MU-59b", "opcua", "latency_ms is always 1.0.", meta(constant_latency), "O1", "ENV-004"),
    defect(
        "MU-60",
        "modbus",
        "meta.endpoint is the default address, not the device's.",
        meta(default_endpoint),
        _EVERY_ITEM,
        "ENV-006",
    ),
    defect(
        "MU-112",
        "modbus",
        "Tools take any object, whatever they need.",
        bare_schema,
        _EVERY_ITEM.removeprefix("M1 "),
        "MCP-003",
    ),
    defect(
        "MU-116w",
        "modbus",
        "Unit, function and address in meta.trace are invented.",
        meta(invented_trace),
        _EVERY_ITEM,
        "ENV-007",
    ),
    defect("MU-124", "modbus", "started_at is the local time with a Z behind it.", local_time, _EVERY_ITEM, "ENC-007"),
)
