"""Steps and windows that the tasks of several protocols share: outages, restarts, recovery."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.journal import Entries
from pytest_otmcp.protocols.unsolicited import nothing_commanded
from pytest_otmcp.trial.expectations import failed
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

__all__ = [
    "CONNECTION_FAULTS",
    "QUIET_S",
    "RAPID_CALLS",
    "SETTLING_S",
    "UNCERTAIN",
    "a_delay_shows",
    "outage",
    "start_without_device",
    "survive_a_restart",
]

RAPID_CALLS = 50

SETTLING_S = 1.0
"""The paper's window: seconds after the endpoint accepts connections again in which a call may still fail."""

NOTICING_S = 1.0
"""Seconds for which a status may still say "connected" after the connection was cut (requirement REC-002: one keep-alive)."""

RECOVERING_S = 5.0
"""Seconds that the same session has to recover (requirement REC-001, the bound for level Silver)."""

QUIET_S = 0.25
"""Seconds for which the device is watched, once per item, for a request that must not come."""

DELAY_S = 0.1
"""Seconds: well above a tick of the coarsest clock, well below every timeout."""

CONNECTION_FAULTS = ("connect_failed", "connection_lost", "timeout")
UNCERTAIN = ("not_sent", "unknown")

Witness = Callable[[Entries], list[Finding]]


async def survive_a_restart(run: Repetition, rig: Rig, operation: str, **inputs: Any) -> None:
    """Perform the operation before, during and after an outage of the endpoint; all three phases are asserted."""
    run.succeeds(await rig.call(operation, **inputs))
    await rig.stop_device()
    run.fails(await rig.call_until_failure(operation, window_s=NOTICING_S, **inputs), *CONNECTION_FAULTS)
    # By now the adapter knows that its connection is gone: what fails is a new one, which is refused.
    refused = await rig.call(operation, role="control", **inputs)
    run.judge(refused, [replace(finding, requirement="ERR-005") for finding in failed(refused, "connect_failed")])
    await rig.start_device()
    run.succeeds((await rig.call_until_success(operation, window_s=SETTLING_S, **inputs))[-1])


async def a_delay_shows(run: Repetition, rig: Rig, operation: str, **inputs: Any) -> None:
    """Perform an operation while the device answers late; that the envelope says how late is judged in every call."""
    await rig.delay(DELAY_S)
    run.succeeds(await rig.call(operation, **inputs))
    await rig.delay(0)


async def outage(run: Repetition, rig: Rig, operation: str, witness: Witness, **inputs: Any) -> None:
    """Measure one trial: warm call, outage, failing call, restart, same session, fresh session.

    Two ways of recovery are measured and never mixed: the same session, which the assistant already has, and a fresh session
    with a process of its own. The time of the same session counts from the moment at which the endpoint accepts connections,
    that of the fresh session from the start of its process. Both are judged at the device.
    """
    warm = await rig.call(operation, **inputs)
    run.must_succeed(warm)
    # A command that an earlier item asked for must not arrive now.
    run.witnessed(nothing_commanded(rig.protocol, await rig.journal()))
    # From here on the outage has been reached, whatever does not come after it.
    stop_ms = await rig.stop_device()
    run.phases = {
        "warm_call": warm.latency_ms,
        "stop": stop_ms,
        "detect": None,
        "restart": None,
        "same_session": None,
        "same_session_attempts": 0,
        "same_session_ok": False,
        "fresh_session": None,
        "fresh_session_ok": False,
    }
    phases = run.phases
    failing = await rig.call_until_failure(operation, window_s=NOTICING_S, **inputs)
    run.fails(failing, *CONNECTION_FAULTS)
    phases["detect"] = failing.latency_ms
    phases["restart"] = await rig.start_device()

    # An adapter that only claims to work in a new session is not tested in the same session.
    if rig.claims("recovery"):
        attempts = await rig.call_until_success(operation, window_s=RECOVERING_S, **inputs)
        recovered = attempts[-1]
        run.succeeds(recovered)
        run.witnessed(witness(await rig.journal()))
        phases["same_session_attempts"] = len(attempts)
        if recovered.success:
            phases["same_session"] = milliseconds(rig.accepting_ns, recovered.exchange.received_ns)
            phases["same_session_ok"] = True

    fresh = await rig.fresh_session()
    first = await rig.call(operation, **inputs)
    run.succeeds(first)
    run.witnessed(witness(await rig.session_journal()))
    run.witnessed(nothing_commanded(rig.protocol, await rig.journal()))
    if first.success:
        phases["fresh_session"] = milliseconds(fresh.spawned_ns, first.exchange.received_ns)
        phases["fresh_session_ok"] = True


async def start_without_device(run: Repetition, rig: Rig, operation: str, **inputs: Any) -> None:
    """Start the adapter while its device is down: it has to start, to say what is wrong, and to work when the device is there."""
    # A step that connects cannot succeed now, so there is no session to ask.
    if not rig.reconnects:
        return
    await rig.stop_device()
    await rig.fresh_session()
    run.fails(await rig.call(operation, **inputs), *CONNECTION_FAULTS)
    await rig.start_device()
    if rig.claims("recovery"):
        run.succeeds((await rig.call_until_success(operation, window_s=RECOVERING_S, **inputs))[-1])


def milliseconds(begin_ns: int, end_ns: int | None) -> float | None:
    return None if end_ns is None else (end_ns - begin_ns) / 1e6
