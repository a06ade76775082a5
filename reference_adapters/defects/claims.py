"""Defects of what an adapter says of its calls and tools, while it does what it is asked for."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from datetime import datetime

from ..core import AdapterServer, Call
from ..core import call as core_call
from .mutant import Bend, Data, Mutant

__all__ = [
    "MUTANTS",
    "bare_schema",
    "constant_latency",
    "invented_trace",
    "latency_in_seconds",
    "meta",
    "one_attempt",
]

_EVERY_ITEM = "M1 M2 M3 M4 X1 X2 X1p X2p FM1 FM2 FX1 S1 S4 S7 S10"


def meta(change: Callable[[Data], None]) -> Bend:
    """Return the defect that every envelope says something else about its call."""

    def bend(server: AdapterServer) -> None:
        genuine = core_call.Call._meta

        def changed(call: Call) -> Data:
            stated = genuine(call)
            change(stated)
            return stated

        core_call.Call._meta = changed

    return bend


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


MUTANTS = (
    Mutant(
        id="MU-26",
        protocol="modbus",
        sentence="attempts is always 1.",
        bend=meta(one_attempt),
        items="M4 FM1 FM2",
        requirements="ENV-005",
    ),
    Mutant(
        id="MU-53h",
        protocol="modbus",
        sentence="The tool that writes a register has a readOnlyHint.",
        bend=says_it_only_reads,
        items="M3 M4 X2 X2p FM2 S4 S10",
        requirements="MCP-008",
    ),
    Mutant(
        id="MU-59a",
        protocol="modbus",
        sentence="latency_ms is in seconds.",
        bend=meta(latency_in_seconds),
        items="M1",
        requirements="ENV-004",
    ),
    Mutant(
        id="MU-59b",
        protocol="opcua",
        sentence="latency_ms is always 1.0.",
        bend=meta(constant_latency),
        items="O1",
        requirements="ENV-004",
    ),
    Mutant(
        id="MU-60",
        protocol="modbus",
        sentence="meta.endpoint is the default address, not the device's.",
        bend=meta(default_endpoint),
        items=_EVERY_ITEM,
        requirements="ENV-006",
    ),
    Mutant(
        id="MU-112",
        protocol="modbus",
        sentence="Tools take any object, whatever they need.",
        bend=bare_schema,
        items=_EVERY_ITEM.removeprefix("M1 "),
        requirements="MCP-003",
    ),
    Mutant(
        id="MU-116w",
        protocol="modbus",
        sentence="Unit, function and address in meta.trace are invented.",
        bend=meta(invented_trace),
        items=_EVERY_ITEM,
        requirements="ENV-007",
    ),
    Mutant(
        id="MU-124",
        protocol="modbus",
        sentence="started_at is the local time with a Z behind it.",
        bend=local_time,
        items=_EVERY_ITEM,
        requirements="ENC-007",
    ),
)
