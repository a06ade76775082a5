"""Calls and findings of a repetition as ``run.json`` has them."""

from __future__ import annotations

import hashlib

from ..core.finding import Finding
from ..record.schema import Call, Frames
from ..record.schema import Finding as StoredFinding
from ..session.exchange import Exchange
from .ledger import Judged, Ledger

__all__ = ["KEPT_OF_A_FRAME", "stored_calls", "stored_finding"]

KEPT_OF_A_FRAME = 16_384
"""Bytes that are kept of a frame: an adapter may send megabytes, again and again; the record has the digest of the whole."""


def stored_calls(ledger: Ledger) -> list[Call]:
    """Return the calls of a repetition as ``run.json`` has them.

    The envelope of a good reply says all that its frames said. The frames are kept where they show more: where there is a
    fault, or where the answer is no envelope.
    """
    return [
        _call(
            call,
            with_frames=ledger.failed
            or bool(call.reply.faults)
            or not call.reply.native
            or call.reply.envelope is None,
        )
        for call in ledger.calls
    ]


def _call(judged: Judged, *, with_frames: bool) -> Call:
    reply, exchange = judged.reply, judged.reply.exchange
    stored: Call = {
        "role": judged.role,
        "adapter": reply.adapter,
        "variant": reply.variant,
        "operation": reply.operation,
        "tool": reply.tool,
        "arguments": dict(reply.arguments),
        "latency_ms": None if reply.latency_ms is None else round(reply.latency_ms, 4),
        "ok": bool(judged.ok) and not reply.faulty,
        "envelope": reply.envelope,
        "native": reply.native,
        "listed": reply.listed,
        "outputs": reply.outputs,
        "error_code": reply.error_code,
        "inputs": dict(judged.inputs),
        "group": judged.group,
        "sent_ns": exchange.sent_ns,
        "received_ns": exchange.received_ns,
    }
    if exchange.starved_ns:
        stored["starved_ns"] = exchange.starved_ns
    if judged.altered is not None:
        stored["altered"] = judged.altered.as_record()
    if reply.taken:
        stored["taken"] = dict(reply.taken)
    if with_frames:
        stored["frames_sha256"] = hashlib.sha256(exchange.request + b"\n" + (exchange.response or b"")).hexdigest()
        stored["frames"] = _frames(reply.faults, exchange)
    return stored


def _frames(faults: tuple[Finding, ...], exchange: Exchange) -> Frames:
    return {
        "request": _frame(exchange.request),
        "response": None if exchange.response is None else _frame(exchange.response),
        "failure": exchange.failure,
        "complaint": exchange.client_complaint,
        "faults": [stored_finding(fault) for fault in faults],
    }


def _frame(frame: bytes) -> str:
    text = frame[:KEPT_OF_A_FRAME].decode("utf-8", "backslashreplace")
    return text if len(frame) <= KEPT_OF_A_FRAME else f"{text}… ({len(frame)} bytes)"


def stored_finding(finding: Finding) -> StoredFinding:
    """Return a finding as ``run.json`` has it."""
    return {
        "code": finding.code,
        "message": finding.message,
        "requirement": finding.requirement,
        "evidence": finding.evidence,
        "strength": finding.strength,
        "cause": finding.cause,
    }
