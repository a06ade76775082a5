"""What one tool call showed: the exchange on the wire, read strictly, with the envelope's own faults.

Pure: knows neither pytest nor asyncio nor any protocol library.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ..core.finding import Finding
from ..core.strict_json import parse_strict
from ..protocols.envelope import check_result
from ..protocols.registry import protocols
from ..subject.answers import extract, interpret, read_answer, synthesised, synthesised_from_outputs
from ..subject.model import Answering, OutputRule

__all__ = ["Reply", "Wire", "observe", "performed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Wire:
    """The frames of one call and their times.

    Attributes:
        request, response: frames without their newline; no response is None.
        sent_ns, received_ns: monotonic; request written, response line read.
        failure: ``timeout`` or ``connection_closed`` when there is no response.
        client_complaint: what the official MCP client objected to, or None.
        asked_ns, returned_ns: monotonic; the MCP client was asked, and was done with the response. 0 where nobody
            measured how the kit spent its time.
    """

    request: bytes
    response: bytes | None
    sent_ns: int
    received_ns: int | None
    failure: str | None
    client_complaint: str | None
    asked_ns: int = 0
    returned_ns: int = 0


@dataclass(slots=True, kw_only=True)
class Reply:
    """One tool call as observed.

    Attributes:
        adapter, variant: whose session it was, such as ``modbus`` and ``rw``.
        operation: the abstract operation, such as ``read_input``.
        role: ``task``, ``control``, ``setup``, ``warmup`` or ``recovery``; only ``task`` calls count for the benchmark.
        envelope: the structured content when it is an object; for an adapter with answers of its own one that is made
            from them; else None.
        native: the envelope is the adapter's own.
        listed: the session lists the tool; the read-only variant may do without its writing tools.
        outputs: the operation's outputs that the binding knows how to find.
        faults: what is wrong with the reply as such, whatever the task expected of it.
        ok: the call met its task's expectation; None until an oracle has judged it.
    """

    adapter: str
    variant: str
    operation: str
    tool: str
    arguments: Mapping[str, Any]
    role: str
    wire: Wire
    envelope: dict[str, Any] | None
    outputs: dict[str, Any]
    faults: list[Finding]
    native: bool = True
    listed: bool = True
    ok: bool | None = None
    group: int = 0

    @property
    def latency_ms(self) -> float | None:
        """Request written to response line read, in milliseconds; None without a response."""
        if self.wire.received_ns is None:
            return None
        return (self.wire.received_ns - self.wire.sent_ns) / 1e6

    @property
    def success(self) -> bool | None:
        """The envelope's ``success``; None when there is none."""
        value = (self.envelope or {}).get("success")
        return value if isinstance(value, bool) else None

    @property
    def error_code(self) -> str | None:
        """The envelope's ``error.code``, or None."""
        error = (self.envelope or {}).get("error")
        code = error.get("code") if isinstance(error, dict) else None
        return code if isinstance(code, str) else None

    @property
    def label(self) -> str:
        """How findings name this call."""
        arguments = ", ".join(f"{name}={value!r}" for name, value in self.arguments.items())
        return f"{self.tool}({arguments})"[:160]

    def as_record(self) -> dict[str, Any]:
        """The call as ``run.json`` has it."""
        frames = hashlib.sha256(self.wire.request + b"\n" + (self.wire.response or b"")).hexdigest()
        return {
            "role": self.role,
            "adapter": self.adapter,
            "variant": self.variant,
            "operation": self.operation,
            "tool": self.tool,
            "arguments": dict(self.arguments),
            "latency_ms": None if self.latency_ms is None else round(self.latency_ms, 4),
            "ok": bool(self.ok) and not self.faults,
            "envelope": self.envelope,
            "native": self.native,
            "listed": self.listed,
            "outputs": self.outputs,
            "error_code": self.error_code,
            "frames_sha256": frames,
        }


def observe(
    wire: Wire,
    *,
    adapter: str,
    variant: str,
    operation: str,
    tool: str,
    arguments: Mapping[str, Any],
    role: str,
    deadline_s: float,
    answering: Answering,
    outputs: Mapping[str, OutputRule],
    listed: bool,
) -> Reply:
    """Read the frames strictly and note every fault of the reply as such.

    Args:
        answering, outputs: the subject's rules for reading the answer.
        listed: see :class:`Reply`.
    """
    faults: list[Finding] = []
    reply = Reply(
        adapter=adapter,
        variant=variant,
        operation=operation,
        tool=tool,
        arguments=arguments,
        role=role,
        wire=wire,
        envelope=None,
        outputs={},
        faults=faults,
        native=answering.native,
        listed=listed,
    )
    if wire.response is None:
        faults.append(_no_response(reply, deadline_s))
        return reply
    try:
        message = parse_strict(wire.response)
    except ValueError as error:
        faults.append(
            Finding(
                code="not_strict_json",
                message=f"{reply.label}: the response is not strict JSON: {error}",
                requirement="ENV-003",
                evidence=_excerpt(wire.response),
            )
        )
        return reply
    if reply.native and listed:
        _read_envelope(reply, message)
    else:
        _read_answer(reply, message, answering)
    if reply.envelope is not None:
        document = reply.envelope if answering.native else read_answer(message, answering.form)[0]
        reply.outputs = extract(outputs, document)
    if wire.client_complaint is not None and "result" in message:
        faults.append(
            Finding(
                code="client_rejects",
                message=f"{reply.label}: the official MCP client rejects the result: {wire.client_complaint}",
                requirement="MCP-006",
                evidence=_excerpt(wire.response),
            )
        )
    if reply.latency_ms is not None and reply.latency_ms > deadline_s * 1000:
        faults.append(
            Finding(
                code="deadline_missed",
                message=f"{reply.label}: answered after {reply.latency_ms:.0f} ms, deadline {deadline_s:g} s",
                requirement="TMO-001",
            )
        )
    return reply


def performed(reply: Reply, outputs: Mapping[str, Any], refused: tuple[str, str] | None) -> None:
    """Let count what a function of the bindings file made of the answers that it got.

    Args:
        outputs: what it found.
        refused: code and words, when it took the answers for a refusal.
    """
    if reply.envelope is None:
        return
    reply.outputs = dict(outputs)
    reply.envelope = synthesised_from_outputs(outputs, refused, protocol=reply.adapter, operation=reply.operation)
    if refused is not None:
        # What admits not to be the device's claims nothing any more: the function has seen that, too.
        reply.faults[:] = [fault for fault in reply.faults if fault.code != "not_from_the_device"]


def _read_envelope(reply: Reply, message: Mapping[str, Any]) -> None:
    result = message.get("result")
    if not isinstance(result, dict):
        reply.faults.append(
            Finding(
                code="json_rpc_error",
                message=f"{reply.label}: answered with a JSON-RPC error instead of a tool result: {message.get('error')}",
                requirement="MCP-007",
                evidence=_excerpt(reply.wire.response or b""),
            )
        )
        return
    for fault in check_result(result, measured_latency_ms=reply.latency_ms):
        reply.faults.append(replace(fault, message=f"{reply.label}: {fault.message}"))
    structured = result.get("structuredContent")
    reply.envelope = structured if isinstance(structured, dict) else None


def _read_answer(reply: Reply, message: Mapping[str, Any], answering: Answering) -> None:
    """Make an envelope from an answer that has none, by the rules of the subject file."""
    answer = interpret(message, answering)
    if not reply.listed and not answer.success:
        # What is not there cannot be used: a guard as good as a refusal in words (requirement MCP-008), whatever a rule
        # meant for other answers makes of "Unknown tool".
        answer = replace(answer, code="writes_disabled")
    reply.native = False
    writes = protocols()[reply.adapter].operations[reply.operation].writes
    reply.envelope = synthesised(answer, protocol=reply.adapter, operation=reply.operation, writes=writes)
    if answer.admission is not None:
        reply.faults.append(
            Finding(
                code="not_from_the_device",
                message=f"{reply.label}: claims success, but says itself that it is not the device's: {answer.admission}",
                requirement="RD-004",
                evidence=_excerpt(reply.wire.response or b""),
            )
        )


def _no_response(reply: Reply, deadline_s: float) -> Finding:
    if reply.wire.failure == "timeout":
        return Finding(
            code="no_reply",
            message=f"{reply.label}: no reply within the deadline of {deadline_s:g} s",
            requirement="TMO-001",
        )
    return Finding(
        code="session_lost",
        message=f"{reply.label}: no reply, the session ended",
        requirement="MCP-007",
    )


def _excerpt(frame: bytes) -> str:
    text = frame[:400].decode("utf-8", "replace")
    return text + (f"… ({len(frame)} bytes)" if len(frame) > 400 else "")
