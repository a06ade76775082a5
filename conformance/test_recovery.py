"""The recovery suite: one outage per trial, and how long it takes until the assistant can work again.

Two ways back are measured and never mixed: the same session, which the assistant already has, and a fresh session with
a process of its own. Times of recovery count from the moment at which the endpoint accepts connections.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.modbus import oracle as modbus
from pytest_otmcp.protocols.mqtt import oracle as mqtt
from pytest_otmcp.protocols.opcua import oracle as opcua
from pytest_otmcp.protocols.unsolicited import nothing_commanded
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Entry
from pytest_otmcp.trial.task import Steps, Suite, Task

RECOVERY = Suite("recovery", warm_up=False)

WINDOW_S = 5.0
"""How long the same session is given to recover (requirement REC-001, the bound for level Silver)."""

CONNECTION_FAULTS = ("connect_failed", "connection_lost", "timeout")


NOTICING_S = 1.0
"""How long a status may still say "connected" after the connection was cut (requirement REC-002: one keep-alive)."""

Witness = Callable[[list[Entry]], list[Finding]]


def outage(protocol: str, operation: str, witness: Witness, **inputs: Any) -> Steps:
    """One trial: warm call, outage, failing call, restart, same session, fresh session; the device witnesses both."""

    async def steps(run: Repetition) -> None:
        at = run.at(protocol)
        warm = await at.call(operation, **inputs)
        run.must_succeed(warm)
        # Nothing of what was asked for in other items may come now.
        run.witnessed(nothing_commanded(protocol, await at.journal()))
        stop_ms = await at.stop_device()
        failing = await at.call_until_failure(operation, window_s=NOTICING_S, **inputs)
        run.fails(failing, *CONNECTION_FAULTS)
        restart_ms = await at.start_device()

        attempts = []
        # An adapter that only promises to work in a new session is not asked for more.
        if at.claims("recovery"):
            attempts = await at.call_until_success(operation, window_s=WINDOW_S, **inputs)
            run.succeeds(attempts[-1])
            run.witnessed(witness(await at.journal()))
        recovered = attempts[-1] if attempts and attempts[-1].success else None
        accepting_ns = at.accepting_ns

        fresh = await at.fresh_session()
        first = await at.call(operation, **inputs)
        run.succeeds(first)
        run.witnessed(witness(await at.session_journal()))

        run.witnessed(nothing_commanded(protocol, await at.journal()))

        run.phases = {
            "warm_call": warm.latency_ms,
            "stop": stop_ms,
            "detect": failing.latency_ms,
            "restart": restart_ms,
            "same_session": milliseconds(accepting_ns, recovered.exchange.received_ns) if recovered else None,
            "same_session_attempts": len(attempts),
            "same_session_ok": recovered is not None,
            "fresh_session": milliseconds(fresh.spawned_ns, first.exchange.received_ns) if first.success else None,
            "fresh_session_ok": bool(first.success),
        }

    return steps


def milliseconds(begin_ns: int, end_ns: int | None) -> float | None:
    return None if end_ns is None else (end_ns - begin_ns) / 1e6


def declare(family: str, title: str, needs: str, witness: Witness, **inputs: Any) -> None:
    protocol, operation = needs.split(".")
    task = RECOVERY.task(f"R-{protocol}", family, title, needs=needs, requirements="REC-001 REC-002 MCP-009")
    task(outage(protocol, operation, witness, **inputs))


TEMPERATURE = "ns=2;s=Temperature"

declare(
    "Modbus",
    "Recover from a restart of the Modbus device.",
    "modbus.read_input",
    modbus.some_exchange,
    address=0,
    count=4,
)
declare("MQTT", "Recover from a restart of the MQTT broker.", "mqtt.info", mqtt.exchange)
declare(
    "OPC UA",
    "Recover from a restart of the OPC UA server.",
    "opcua.read",
    partial(opcua.read_from_device, node=TEMPERATURE),
    node=TEMPERATURE,
)


@pytest.mark.parametrize("task", RECOVERY, ids=lambda task: task.id)
def test_recovery(task: Task, otmcp_trial: Callable[[Task], None]) -> None:
    otmcp_trial(task)
