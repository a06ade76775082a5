"""Synthetic run records for tests; nothing in the kit uses them."""

from __future__ import annotations

from functools import cache
from typing import Any

from pytest_otmcp.core.matrix import BENCHMARK
from pytest_otmcp.core.verdict import Status, Verdict, decide
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record.consistency import count_calls
from pytest_otmcp.suite.catalogue import all_tasks, identity

_TASKS = cache(all_tasks)

RUN_ID = "7" * 32
DIGEST = "sha256:" + "0" * 64

PHASES = {
    "warm_call": 1.0,
    "stop": 2.0,
    "detect": 1.5,
    "restart": 5.0,
    "same_session": 4.0,
    "same_session_attempts": 1,
    "same_session_ok": True,
    "fresh_session": 500.0,
    "fresh_session_ok": True,
}


def call(
    latency_ms: float = 1.0, *, ok: bool = True, error_code: str | None = None, role: str = "task"
) -> dict[str, Any]:
    return {
        "role": role,
        "adapter": "modbus",
        "variant": "rw",
        "operation": "ping",
        "inputs": {},
        "tool": "ping",
        "arguments": {},
        "group": 1,
        "sent_ns": 0,
        "received_ns": int(latency_ms * 1e6),
        "latency_ms": latency_ms,
        "ok": ok,
        "envelope": None if error_code is None else {"success": False, "error": {"code": error_code}},
        "native": True,
        "listed": True,
        "outputs": {},
        "error_code": error_code,
    }


def finding(code: str, message: str, requirement: str | None = None, evidence: str | None = None) -> dict[str, Any]:
    told = {"code": code, "message": message, "requirement": requirement, "evidence": evidence}
    return {**told, "strength": "MUST", "cause": None}


def item(
    identifier: str,
    suite: str,
    family: str,
    title: str,
    times: list[float],
    *,
    error_code: str | None = None,
    failing: int = 0,
) -> dict[str, Any]:
    """Return an item with one sample per time; the last ``failing`` samples fail."""
    samples = []
    for repetition, time in enumerate(times):
        ok = repetition < len(times) - failing
        samples.append(
            {
                "repetition": repetition,
                "ok": ok,
                "duration_ms": time,
                "calls": [call(time, ok=ok, error_code=error_code)],
                "device": [],
                "observations": [],
                "findings": [] if ok else [finding("wrong_value", "values differ", "RD-001")],
                "phases": dict(PHASES) if suite == "recovery" else None,
            }
        )
    return {
        "id": identifier,
        "run_id": RUN_ID,
        "order": list(_TASKS()).index(identifier) if identifier in _TASKS() else 1000,
        "suite": suite,
        "family": family,
        "title": title,
        "capabilities": list(_TASKS()[identifier].capabilities) if identifier in _TASKS() else [],
        "requirements": [],
        "status": "FAIL" if failing else "PASS",
        "reason": None,
        "planned": len(times),
        "worker": "main",
        "started_at": "2026-11-21T07:03:43.000Z",
        "finished_at": "2026-11-21T07:03:44.000Z",
        "began_ns": 0,
        "ended_ns": 0,
        "findings": [],
        "requirement_rows": [],
        "timing_ms": {},
        "devices": {},
        "around": [],
        "sessions": [],
        "ended": None,
        "samples": samples,
    }


def around(role: str, *calls: dict[str, Any]) -> dict[str, Any]:
    """Return the record of the set-up, the warm-up or the closing checks of an item."""
    return {"role": role, "calls": list(calls), "device": [], "observations": []}


def wire(request: str, response: str | None, sent_ms: float, received_ms: float | None) -> dict[str, Any]:
    """Return the members that only the record of a call in a failing repetition has."""
    times = {"sent_ns": int(sent_ms * 1e6), "received_ns": None if received_ms is None else int(received_ms * 1e6)}
    failure = "timeout" if response is None else None
    frames = {"request": request, "response": response, "failure": failure, "complaint": None, "faults": []}
    return {**times, "frames": frames}


def entry(at_ms: float, direction: str, kind: str, **facts: Any) -> dict[str, Any]:
    """Return an entry of a device's journal."""
    place = {"protocol": "modbus", "seq": 0, "t_ns": int(at_ms * 1e6), "connection": 1, "origin": "client"}
    contract = {"request": kind == "request", "state_changing": False, "answers": None}
    return {**place, "direction": direction, "kind": kind, **contract, **facts}


def written_twice(repetitions: int = 1) -> dict[str, Any]:
    """Return an item all of whose repetitions fail: the adapter says written, the device saw two writes."""
    failed = item("M3", "normal", "Modbus", "Write a register.", [2.0] * repetitions, failing=repetitions)
    failed["requirements"] = ["WR-001", "WR-003"]
    for sample in failed["samples"]:
        spoken = call(2.0)
        spoken |= {"tool": "write_register", "arguments": {"address": 1, "value": 40}}
        spoken["envelope"] = {"success": True, "data": {"value": 40}, "error": None, "meta": {"attempts": 2}}
        spoken |= wire('{"method":"tools/call"}', '{"result":{}}', 100, 102)
        write = {"function": 6, "address": 1, "values": [40], "state_changing": True}
        sample["calls"] = [spoken]
        sample["device"] = [
            entry(100.5, "in", "request", pdu="0600010028", **write),
            entry(100.6, "out", "response", pdu="0600010028", function=6, exception=None),
            entry(101.5, "in", "request", pdu="0600010028", **write),
        ]
        message = "the device should have seen one write, it saw 2"
        sample["findings"] = [finding("not_written_once", message, "WR-003", "FC 06; FC 06")]
    return failed


def run(items: list[dict[str, Any]], *, complete: bool = True, timing_valid: bool = True) -> dict[str, Any]:
    """Return a consistent record of these items."""
    verdict = decide({entry["id"]: Status(entry["status"]) for entry in items}, [entry["id"] for entry in items])
    return {
        "schema": "otmcp-run/3",
        "run_id": RUN_ID,
        "kit": {
            "name": "pytest-otmcp",
            "version": "0.0.0",
            "digest": DIGEST,
            "suite_digest": DIGEST,
            "protocols": [identity(protocols()[key]) for key in ("modbus", "mqtt", "opcua")],
        },
        "subject": {
            "name": "synthetic",
            "version": "0",
            "digest": DIGEST,
            "deviations": [],
            "adapters": {name: adapter(tools) for name, tools in (("modbus", 17), ("mqtt", 15), ("opcua", 7))},
        },
        "environment": {
            "python": "3.11.7",
            "platform": "Linux x86_64",
            "cpu_count": 2,
            "packages": {},
            "started_at": "2026-11-21T07:03:43Z",
            "finished_at": "2026-11-21T07:13:43Z",
        },
        "settings": {
            "subject": None,
            "reps": 30,
            "repetitions": {},
            "seed": 0,
            "era": "auto",
            "time_scale": 1.0,
            "suites": list(BENCHMARK),
            "xdist_workers": 0,
            "broker": "embedded",
            "narrowed": [],
        },
        "devices": {},
        "items": items,
        "footer": {
            "complete": complete,
            "reason": None if complete else "interrupted by the user",
            "items": len(items),
            "samples": sum(len(entry["samples"]) for entry in items),
            "tool_calls": count_calls(items),
            "verdict": str(verdict if complete else Verdict.INCOMPLETE),
            "deviations": {"used": [], "stale": [], "expired": []},
            "elapsed_s": 1.0,
            "breakdown_s": {"tool calls": 0.4, "kit": 0.6},
            "timing_valid": timing_valid,
        },
    }


def adapter(tools: int | None, **more: Any) -> dict[str, Any]:
    """Return what a record says of an adapter."""
    server = {"server_name": "acme", "server_version": "1", "protocol_version": "2026-07-28", "tools": tools}
    return {
        "command": ["acme-adapter"],
        "envelope": "native",
        "recovery": "same_session",
        "recovery_s": 5.0,
        "lists": {},
        "cached": {},
        "deadline_s": 5.0,
        "unclaimed": {},
        "blocking": [],
        "lacks": [],
        "probes": {},
        "bindings": {},
        "unjudged": [],
        "unmet": [],
        "listing": {},
        **server,
        **more,
    }
