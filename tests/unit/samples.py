"""Builds synthetic run records for tests; nothing in the kit uses them."""

from __future__ import annotations

from typing import Any

from pytest_otmcp.core.verdict import Status, Verdict, decide
from pytest_otmcp.record.run_file import count_calls, digest

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
        "tool": "ping",
        "arguments": {},
        "latency_ms": latency_ms,
        "ok": ok,
        "envelope": None,
        "error_code": error_code,
        "frames_sha256": "0" * 64,
    }


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
    """An item with one sample per time; the last ``failing`` samples fail."""
    samples = []
    for repetition, time in enumerate(times):
        ok = repetition < len(times) - failing
        finding = {"code": "wrong_value", "message": "values differ", "requirement": "RD-001", "evidence": None}
        samples.append(
            {
                "repetition": repetition,
                "ok": ok,
                "duration_ms": time,
                "calls": [call(time, ok=ok, error_code=error_code)],
                "device": [],
                "findings": [] if ok else [finding],
                "phases": dict(PHASES) if suite == "recovery" else None,
            }
        )
    return {
        "id": identifier,
        "suite": suite,
        "family": family,
        "title": title,
        "requirements": [],
        "status": "FAIL" if failing else "PASS",
        "planned": len(times),
        "samples": samples,
        "other_calls": [],
        "findings": [],
        "timing_ms": {},
    }


def wire(request: str, response: str | None, sent_ms: float, received_ms: float | None) -> dict[str, Any]:
    """What the record of a call in a failing repetition has besides."""
    times = {"sent_ns": int(sent_ms * 1e6), "received_ns": None if received_ms is None else int(received_ms * 1e6)}
    failure = "timeout" if response is None else None
    return {**times, "frames": {"request": request, "response": response, "failure": failure, **times}}


def entry(at_ms: float, direction: str, kind: str, **facts: Any) -> dict[str, Any]:
    """An entry of a device's journal."""
    place = {"protocol": "modbus", "seq": 0, "t_ns": int(at_ms * 1e6), "connection": 1}
    return {**place, "direction": direction, "kind": kind, **facts}


def written_twice(repetitions: int = 1) -> dict[str, Any]:
    """An item all of whose repetitions fail: the adapter says written, the device saw two writes."""
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
        sample["findings"] = [
            {
                "code": "not_written_once",
                "message": "the device should have seen one write, it saw 2",
                "requirement": "WR-003",
                "evidence": "FC 06; FC 06",
            }
        ]
    return failed


def run(items: list[dict[str, Any]], *, complete: bool = True, timing_valid: bool = True) -> dict[str, Any]:
    """A consistent record of these items."""
    verdict = decide({entry["id"]: Status(entry["status"]) for entry in items}, [entry["id"] for entry in items])
    record = {
        "schema": "otmcp-run/1",
        "kit": {"name": "pytest-otmcp", "version": "0.0.0", "suite_digest": "sha256:0"},
        "subject": {
            "name": "synthetic",
            "version": "0",
            "adapters": {"modbus": {"tools": 17}, "mqtt": {"tools": 15}, "opcua": {"tools": 7}},
        },
        "environment": {},
        "settings": {"reps": 30},
        "items": items,
        "footer": {
            "complete": complete,
            "reason": None if complete else "interrupted by the user",
            "items": len(items),
            "samples": sum(len(entry["samples"]) for entry in items),
            "tool_calls": count_calls(items),
            "verdict": str(verdict if complete else Verdict.INCOMPLETE),
            "elapsed_s": 1.0,
            "breakdown_s": {"tool calls": 0.4, "kit": 0.6},
            "timing_valid": timing_valid,
        },
    }
    record["footer"]["digest"] = digest(record)
    return record
