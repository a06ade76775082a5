"""The reply to one tool call: its exchange, read strictly by the subject's rules, with the faults of the reply as such. Pure."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ..core.finding import Finding
from ..core.strict_json import parse_strict
from ..protocols.envelope import check_result
from ..protocols.journal import Entries, JournalEntry
from ..protocols.protocol import GOVERNANCE, LAUNCHES
from ..protocols.registry import protocols
from ..session.exchange import CANCELLED, REFUSALS, TOO_LONG, Exchange
from ..session.limits import TOO_LARGE
from ..subject.answers import (
    UNCLASSIFIED,
    Answer,
    extract,
    interpret,
    read_answer,
    synthesised,
    synthesised_from_outputs,
)
from ..subject.command import SAYS
from ..subject.model import Answering, Binding, OutputRule, placeholders
from .alteration import label

__all__ = ["UNREAD", "Expectation", "Reply", "kept_of", "observe", "replace_outputs"]


UNREAD = {
    REFUSALS[401]: ("HTTP status 401: the caller is not known", "auth_failed"),
    REFUSALS[403]: ("HTTP status 403: the caller may not do this", "access_denied"),
    REFUSALS[413]: ("HTTP status 413: the request is too large", "limit_exceeded"),
}
"""What a refusal by HTTP status says, and the code that stands for it, by the failure of its exchange."""

_WORDLESS = re.compile(
    r"""\s*(?:null|None|\{\}|\[\]|""|(?:error|exception|failed|failure)(?:\s+(?:calling|executing|in|while calling)\s+(?:tool\s+)?['"]?[\w./-]+['"]?)?)?"""
    r"\s*[:.]?\s*",
    re.IGNORECASE,
)
"""Texts of failures that say nothing: what the SDKs put before the words of an exception, and no words behind it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """The rules and the deadline by which the reply of one call is read.

    Attributes:
        adapter, variant: the adapter whose session it was, such as ``modbus`` and ``rw``.
        operation: the abstract operation, such as ``read_input``.
        deadline_s: seconds within which each call of a tool must have answered.
        calls: how many of them performed the operation, one after the other; a Python function may make several.
        answering, outputs: the subject's rules for reading the answer.
        topicless: messages are payloads without their topics; ``topic`` is that of all of them, or None where it cannot be known.
        listed: the session lists the tool; the read-only variant may do without its writing tools.
        meaning: the outputs are what the answer of a named reading means at the device.
        asked: what the answer of a named command has to say, by the name of the output.
    """

    adapter: str
    variant: str
    operation: str
    deadline_s: float
    answering: Answering
    outputs: Mapping[str, OutputRule]
    calls: int = 1
    listed: bool = True
    topicless: bool = False
    topic: str | None = None
    meaning: bool = False
    asked: Mapping[str, object] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        binding: Binding,
        inputs: Mapping[str, object],
        *,
        adapter: str,
        variant: str,
        operation: str,
        deadline_s: float,
        listed: bool,
    ) -> Expectation:
        """Return what a call of a binding with these inputs is read by."""
        described = protocols()[adapter].operations[operation]
        # Who takes no filter answers with the messages of all subscriptions.
        asked = bool(placeholders(binding.arguments) & set(described.optional)) or binding.follows
        return cls(
            adapter=adapter,
            variant=variant,
            operation=operation,
            deadline_s=deadline_s,
            answering=binding.answering,
            outputs=binding.outputs_for(inputs),
            listed=listed,
            topicless=binding.topicless,
            topic=described.topic_of(inputs) if asked and described.topic_of is not None else None,
            meaning=binding.command is not None and binding.command.holds is not None,
            asked=_asked(binding, inputs),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """One tool call as observed.

    Attributes:
        adapter, variant, operation, listed: see :class:`Expectation`.
        exchange: the measured exchange.
        envelope: the structured content when it is an object; an envelope made from the answer for an adapter that
            answers without one; else None.
        outputs: the operation's outputs that the binding knows how to find.
        faults: what is wrong with the reply as such, whatever the task expected of it.
        native: the envelope is the adapter's own.
        taken: the handles of earlier calls that the arguments hold, each by ``step.name``.
        asks: the call has ended with a question for the client.
        meaning: the outputs are what the answer means at the device.
        asked: see :class:`Expectation`.
        excess: the bound of the tool's own schema that the arguments of a call that failed do not keep; None where they keep all.
    """

    adapter: str
    variant: str
    operation: str
    exchange: Exchange
    envelope: dict[str, object] | None
    outputs: dict[str, object]
    faults: tuple[Finding, ...] = ()
    native: bool = True
    listed: bool = True
    taken: Mapping[str, object] = field(default_factory=dict)
    excess: str | None = None
    asks: bool = False
    meaning: bool = False
    asked: Mapping[str, object] = field(default_factory=dict)

    @property
    def tool(self) -> str:
        """Name of the tool, or URI of the resource."""
        return self.exchange.tool

    @property
    def arguments(self) -> Mapping[str, Any]:
        """Arguments of the call."""
        return self.exchange.arguments

    @property
    def answered(self) -> bool:
        """There is a response, or the refusal of a request that was not read."""
        return self.exchange.response is not None or self.exchange.failure in UNREAD

    @property
    def cancelled(self) -> bool:
        """The kit has cancelled the call before there was a response."""
        return self.exchange.failure == CANCELLED

    @property
    def unread(self) -> bool:
        """The answer is an error of MCP instead of a result, or there is none although the session goes on."""
        codes = {fault.code for fault in self.faults if fault.is_must}
        return codes != set() and codes <= {"no_reply", "json_rpc_error"}

    @property
    def latency_ms(self) -> float | None:
        """Request written to response line read, in milliseconds; None without a response."""
        return self.exchange.latency_ms

    @property
    def success(self) -> bool | None:
        """The envelope's ``success``; None when there is none."""
        value = (self.envelope or {}).get("success")
        return value if isinstance(value, bool) else None

    @property
    def unclassified(self) -> bool:
        """The call failed, and neither the adapter nor the subject file says of which class the failure is."""
        return self.error_code == UNCLASSIFIED

    @property
    def error_code(self) -> str | None:
        """The envelope's ``error.code``, or None."""
        error = (self.envelope or {}).get("error")
        code = error.get("code") if isinstance(error, dict) else None
        return code if isinstance(code, str) else None

    def member(self, *path: str) -> object:
        """Return a member of a member of the envelope; None where there is none, whatever the adapter has put in its place."""
        value: object = self.envelope
        for name in path:
            value = value.get(name) if isinstance(value, dict) else None
        return value

    def during(self, entries: Entries) -> list[JournalEntry]:
        """Return those entries of a journal that were made between the request and the reply."""
        begin_ns, end_ns = self.exchange.sent_ns, self.exchange.received_ns
        return [entry for entry in entries if end_ns is not None and begin_ns <= entry["t_ns"] <= end_ns]

    @property
    def faulty(self) -> bool:
        """Whether a MUST for replies as such is not met."""
        return any(fault.is_must for fault in self.faults)

    @property
    def label(self) -> str:
        """Name of this call in findings."""
        return _label(self.exchange)


def _asked(binding: Binding, inputs: Mapping[str, object]) -> dict[str, object]:
    """Return what the answer of a named command has to say, for each output that its binding finds; None for one that stands for nothing, as
    only a forged record has it."""
    command, said = binding.command, [name for name in binding.outputs if name.startswith(SAYS)]
    if command is None or not said:
        return {}
    known = command.asked_for(inputs)
    return {name: known.get(name.removeprefix(SAYS)) for name in said}


def observe(exchange: Exchange, expected: Expectation) -> Reply:
    """Read the frames of an exchange strictly and note every fault of the reply as such."""
    limit_ms = expected.calls * expected.deadline_s * 1000
    if exchange.latency_ms is None or exchange.latency_ms <= limit_ms:
        # Nothing has to be excused, and nothing of it kept.
        exchange = replace(exchange, starved_ns=0)
    silent = Reply(
        adapter=expected.adapter,
        variant=expected.variant,
        operation=expected.operation,
        exchange=exchange,
        envelope=None,
        outputs={},
        native=expected.answering.native,
        listed=expected.listed,
        meaning=expected.meaning,
        asked=expected.asked,
    )
    if exchange.response is None:
        if exchange.failure == CANCELLED:
            return silent
        if exchange.failure in UNREAD:
            return replace(silent, envelope=_unread(expected, exchange.failure), native=False)
        return replace(silent, faults=(_no_response(exchange, expected.deadline_s),))
    try:
        message = parse_strict(exchange.response)
    except ValueError as error:
        return replace(silent, faults=(_not_strict(exchange, exchange.response, error),))
    if expected.variant == LAUNCHES[GOVERNANCE]:
        if _asks(message):
            words = "the adapter asks its client"
            return replace(silent, envelope=_unapproved(expected, "required", words), native=False, asks=True)
        if _is_refused_state(message):
            words = "the state that the call brings is not taken"
            return replace(silent, envelope=_unapproved(expected, "denied", words), native=False)
    # A tool that the session does not list has no envelope to be judged: the answer is read like prose.
    native = expected.answering.native and expected.listed
    envelope, faults = _read_envelope(exchange, message) if native else _read_answer(exchange, message, expected)
    outputs: dict[str, object] = {}
    if envelope is not None:
        own = expected.answering.native
        outputs = extract(expected.outputs, envelope if own else read_answer(message, expected.answering.form)[0])
        if expected.topicless and isinstance(payloads := outputs.get("messages"), list):
            outputs["messages"] = [{"topic": expected.topic, "payload": payload} for payload in payloads]
    return replace(
        silent,
        envelope=envelope,
        outputs=outputs,
        faults=(
            *faults,
            *_contradictory(exchange, message),
            *_client_faults(exchange, message),
            *_timing_faults(exchange, expected.deadline_s, limit_ms),
        ),
        native=native,
    )


def kept_of(rules: Mapping[str, OutputRule], message: Mapping[str, object], answering: Answering) -> dict[str, Any]:
    """Return the handles that a binding, or the connect step, keeps of a JSON-RPC response; one that is not there is None."""
    return extract(rules, read_answer(message, "structured" if answering.native else answering.form)[0])


def replace_outputs(reply: Reply, outputs: Mapping[str, object], refused: tuple[str, str] | None) -> Reply:
    """Replace the outputs of a reply, and what follows from them, by what the user's binding function returned.

    Args:
        outputs: the outputs that the function returned.
        refused: code and words, when the function took the answers for a refusal.
    """
    if reply.envelope is None:
        return reply
    envelope = synthesised_from_outputs(outputs, refused, protocol=reply.adapter, operation=reply.operation)
    faults = reply.faults
    if refused is not None:
        # The function has judged the answer's source as well.
        faults = tuple(fault for fault in faults if fault.code != "not_from_the_device")
    return replace(reply, outputs=dict(outputs), envelope=envelope, faults=faults)


Reading = tuple[dict[str, Any] | None, list[Finding]]
"""The envelope and its faults."""


def _read_envelope(exchange: Exchange, message: Mapping[str, object]) -> Reading:
    result = message.get("result")
    label = _label(exchange)
    if not isinstance(result, dict):
        fault = Finding(
            code="json_rpc_error",
            message=f"{label}: answered with a JSON-RPC error instead of a tool result: {message.get('error')}",
            requirement="MCP-007",
            evidence=_excerpt(exchange.response or b""),
        )
        return None, [fault]
    faults = [
        replace(fault, message=f"{label}: {fault.message}")
        for fault in check_result(result, measured_latency_ms=exchange.latency_ms)
    ]
    structured = result.get("structuredContent")
    return (structured if isinstance(structured, dict) else None), faults


def _read_answer(exchange: Exchange, message: Mapping[str, object], expected: Expectation) -> Reading:
    """Make an envelope from an answer that has none, by the rules of the subject file."""
    answer = interpret(message, expected.answering)
    if not expected.listed and not answer.success:
        # A tool that is not listed counts as "writes disabled" (requirement MCP-008), even if a rule meant for other
        # answers matches the text "Unknown tool".
        answer = replace(answer, code="writes_disabled")
    operation = protocols()[expected.adapter].operations[expected.operation]
    told = None if operation.tells is None else extract(expected.outputs, answer.document).get(operation.tells)
    if answer.success and told is False:
        # The answer came, and says that the device did not: no success, whatever else it says.
        answer = replace(answer, success=False, code="connect_failed")
    envelope = synthesised(answer, protocol=expected.adapter, operation=expected.operation, writes=operation.writes)
    structured, text, _ = read_answer(message, "structured")
    if not answer.success and not structured and _WORDLESS.fullmatch(text):
        return envelope, [_wordless(exchange, text)]
    if answer.admission is None:
        return envelope, []
    fault = Finding(
        code="not_from_the_device",
        message=f"{_label(exchange)}: claims success, but says itself that it is not the device's: {answer.admission}",
        requirement="RD-004",
        evidence=_excerpt(exchange.response or b""),
    )
    return envelope, [fault]


def _wordless(exchange: Exchange, text: str) -> Finding:
    return Finding(
        code="wordless_error",
        message=f"{_label(exchange)}: a failure should say what is wrong, its text is {text!r}",
        requirement="ENV-006",
        strength="SHOULD",
    )


def _unread(expected: Expectation, failure: str) -> dict[str, Any]:
    """Make an envelope for the refusal of a request that the adapter has not read."""
    words, code = UNREAD[failure]
    answer = Answer(success=False, document=None, text=words, code=code)
    operation = protocols()[expected.adapter].operations[expected.operation]
    return synthesised(answer, protocol=expected.adapter, operation=expected.operation, writes=operation.writes)


def _asks(message: Mapping[str, object]) -> bool:
    """Tell whether the call has ended with a question for the client (MCP 2026-07-28, Multi Round-Trip Requests)."""
    result = message.get("result")
    return isinstance(result, dict) and result.get("resultType") == "input_required"


def _is_refused_state(message: Mapping[str, object]) -> bool:
    """Tell whether the call is refused for the state that it brings, as the SDKs do it before a tool is called."""
    error = message.get("error")
    return (
        isinstance(error, dict) and error.get("code") == -32602 and "requeststate" in str(error.get("message")).lower()
    )


def _unapproved(expected: Expectation, what: str, words: str) -> dict[str, Any]:
    """Make an envelope for a call that has ended without the answer of a tool, since an approval is lacking."""
    answer = Answer(success=False, document=None, text=words, code=f"approval_{what}")
    operation = protocols()[expected.adapter].operations[expected.operation]
    return synthesised(answer, protocol=expected.adapter, operation=expected.operation, writes=operation.writes)


def _contradictory(exchange: Exchange, message: Mapping[str, object]) -> list[Finding]:
    """JSON-RPC 2.0, section 5: a response has a result or an error, and not both. An error that is null says nothing."""
    if "result" not in message or message.get("error") is None:
        return []
    return [
        Finding(
            code="json_rpc_error",
            message=f"{_label(exchange)}: answered with a result and with a JSON-RPC error at once: {message['error']}",
            requirement="MCP-007",
            evidence=_excerpt(exchange.response or b""),
        )
    ]


def _client_faults(exchange: Exchange, message: Mapping[str, object]) -> list[Finding]:
    if exchange.client_complaint is None or "result" not in message:
        return []
    return [
        Finding(
            code="client_rejects",
            message=f"{_label(exchange)}: the official MCP client rejects the result: {exchange.client_complaint}",
            requirement="MCP-006",
            evidence=_excerpt(exchange.response or b""),
        )
    ]


def _timing_faults(exchange: Exchange, deadline_s: float, limit_ms: float) -> list[Finding]:
    latency_ms = exchange.latency_ms
    if latency_ms is None or latency_ms - exchange.starved_ns / 1e6 <= limit_ms:
        return []
    return [
        Finding(
            code="deadline_missed",
            message=f"{_label(exchange)}: answered after {latency_ms:.0f} ms, deadline {deadline_s:g} s",
            requirement="TMO-001",
        )
    ]


def _not_strict(exchange: Exchange, response: bytes, error: ValueError) -> Finding:
    return Finding(
        code="not_strict_json",
        message=f"{_label(exchange)}: the response is not strict JSON: {error}",
        requirement="ENV-003",
        evidence=_excerpt(response),
    )


def _no_response(exchange: Exchange, deadline_s: float) -> Finding:
    if exchange.failure == "timeout":
        return Finding(
            code="no_reply",
            message=f"{_label(exchange)}: no reply within the deadline of {deadline_s:g} s",
            requirement="TMO-001",
        )
    if exchange.failure == TOO_LONG:
        return Finding(
            code="frame_too_long",
            message=f"{_label(exchange)}: no reply that is read, as the adapter sent {TOO_LARGE}",
            requirement="ADR-009",
        )
    return Finding(
        code="session_lost",
        message=f"{_label(exchange)}: no reply, the session ended",
        requirement="MCP-007",
    )


def _label(exchange: Exchange) -> str:
    return label(exchange.tool, exchange.arguments)


def _excerpt(frame: bytes) -> str:
    text = frame[:400].decode("utf-8", "replace")
    return text + (f"… ({len(frame)} bytes)" if len(frame) > 400 else "")
