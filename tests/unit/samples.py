"""Builds synthetic run records for tests; nothing in the kit uses them."""

from __future__ import annotations

from typing import Any

from pytest_otmcp.record import digest

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


def run(items: list[dict[str, Any]], *, complete: bool = True, timing_valid: bool = True) -> dict[str, Any]:
    """A consistent record of these items."""
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
            "tool_calls": {"task": 1, "control": 0, "setup": 0, "warmup": 0, "recovery": 0},
            "verdict": "CONFORMANT" if complete else "INCOMPLETE",
            "elapsed_s": 1.0,
            "breakdown_s": {"tool calls": 0.4, "kit": 0.6},
            "timing_valid": timing_valid,
        },
    }
    record["footer"]["digest"] = digest(record)
    return record
