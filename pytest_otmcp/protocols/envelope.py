"""The response envelope ``{success, data, error, meta}``: the rules that every result must keep. Pure.

The schema is data (``envelope.schema.json``), to which the names of the registered protocols are added; the rules that a
schema cannot express are below. Each broken rule is a finding with the id of its requirement.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from functools import cache
from importlib import resources
from typing import Any

from ..core.error_registry import registry
from ..core.finding import Finding
from ..core.strict_json import parse_strict, same_json
from .registry import envelope_names

__all__ = ["check_result"]

# Texts that must never reach an assistant in a message: tracebacks, source paths, representations of objects and
# exceptions, and the endpoint of a client that was never configured ("on None:None").
_LEAKS = re.compile(
    r"""Traceback\ \(most\ recent | File\ "[^"]+",\ line | <[\w.]+\ object\ at\ 0x | <(?:class|function|module)\ '?
    | (?:/[\w.-]+){2,}\.(?:py|js|ts|go|rs|java)\b | [A-Za-z]:\\[\w.-]+\\ | \b\w+(?:Error|Exception)\( | \bNone:None\b""",
    re.VERBOSE,
)
_SEARCHED = 4000
"""Characters of a message that are searched: the time that a long row of slashes takes grows with its square."""
_ENDPOINT = re.compile(r"[a-z][a-z0-9+.-]*://(?:(?:\[[0-9a-fA-F:.]+\]|[^/@\s:]+):\d{1,5}(?:/\S*)?|/\S+)")
"""A host and its port, or the path of a serial line."""
_ROUNDING_MS = 0.1
"""Envelopes round their latency; no judgement depends on less than this."""
_CLOCK_MS = 15.625 + 1.0
"""What a truthful clock may show too much: one tick of a clock of 64 Hz (Windows, Python before 3.13), in whole milliseconds."""


@cache
def _validator() -> Any:
    from jsonschema import Draft202012Validator

    schema = json.loads((resources.files(__package__) / "envelope.schema.json").read_text(encoding="utf-8"))
    schema["properties"]["meta"]["properties"]["protocol"] = {"enum": list(envelope_names())}
    return Draft202012Validator(schema)


def check_result(
    result: Mapping[str, object],
    *,
    measured_latency_ms: float | None = None,
    injected_delay_ms: float = 0.0,
) -> list[Finding]:
    """Judge the ``result`` of a ``tools/call`` response, whatever its task expected.

    Args:
        result: as parsed from the wire.
        measured_latency_ms: from request written to response read, as the kit measured it.
        injected_delay_ms: time for which the kit delayed the device during the call; the adapter cannot have been faster.
    """
    return list(_faults(result, measured_latency_ms, injected_delay_ms))


def _faults(result: Mapping[str, object], measured_ms: float | None, delay_ms: float) -> Iterator[Finding]:
    envelope = result.get("structuredContent")
    if not isinstance(envelope, dict):
        yield Finding(
            code="no_envelope",
            message="the result has no structuredContent object {success, data, error, meta}",
            requirement="ENV-001",
            evidence=json.dumps(result, ensure_ascii=False)[:400],
        )
        return
    yield from _renderings(result, envelope)
    schema_faults = sorted(_validator().iter_errors(envelope), key=lambda error: list(map(str, error.absolute_path)))
    for fault in schema_faults[:3]:
        where = "/".join(map(str, fault.absolute_path)) or "the envelope"
        yield Finding(code="envelope_schema", message=f"{where}: {_reason(fault)[:300]}", requirement="ENV-001")
    success, error = envelope.get("success"), envelope.get("error")
    # The protocol's default for an absent isError is false (MCP 2025-11-25, CallToolResult).
    is_error = result.get("isError", False)
    if not isinstance(is_error, bool) or is_error == bool(success):
        yield Finding(
            code="is_error",
            message=f"isError is {is_error} although success is {success}",
            requirement="MCP-006",
        )
    if (success is True) != (error is None):
        yield Finding(
            code="success_and_error",
            message=f"success is {success} while error is {'null' if error is None else 'given'}",
            requirement="ENV-002",
        )
    if success is False and isinstance(data := envelope.get("data"), dict) and set(data) != {"partial"}:
        yield Finding(code="data_on_failure", message="a failure carries data", requirement="ENV-002")
    yield from _two_answers(envelope)
    if path := _not_finite(envelope):
        yield Finding(code="not_finite", message=f"{path} is no finite number", requirement="ENV-003")
    if isinstance(error, dict):
        yield from _error_faults(error)
    meta = envelope.get("meta")
    if isinstance(meta, dict):
        yield from _meta_faults(meta, measured_ms, delay_ms)
        yield from _contradictions(meta, error if isinstance(error, dict) else {})


_REFUSED_HERE = ("validation", "policy")
_MAY_HAVE_HAPPENED = ("unknown", "partial", "applied")


def _two_answers(envelope: Mapping[str, Any]) -> Iterator[Finding]:
    """Judge what contradicts the rest of one and the same answer: an error within the data of a success, and the advice to repeat what
    may have happened."""
    data, error = envelope.get("data"), envelope.get("error")
    if envelope.get("success") is True and isinstance(data, dict):
        told = data.get("error")
        if (isinstance(told, str | dict) and told) or data.get("success") is False:
            yield Finding(
                code="error_in_data",
                message="success is True while data says that it failed",
                requirement="ENV-002",
                evidence=json.dumps(told, ensure_ascii=False)[:400],
            )
    if isinstance(error, dict) and error.get("retryable") is True and error.get("outcome") in _MAY_HAVE_HAPPENED:
        yield Finding(
            code="unsafe_retry",
            message=f"retryable is True although the outcome is {error['outcome']!r}: the first request may have been carried out",
            requirement="ENV-002",
        )


def _reason(fault: Any) -> str:
    # "is not valid under any of the given schemas" helps nobody: say what is wrong with the error object.
    if fault.validator == "oneOf" and isinstance(fault.instance, dict):
        for inner in fault.context:
            if inner.absolute_schema_path[-1] != "type" or inner.absolute_path != fault.absolute_path:
                member = "/".join(map(str, inner.relative_path))
                return f"{member}: {inner.message}" if member else str(inner.message)
    return str(fault.message)


def _not_finite(value: object, path: str = "") -> str | None:
    if isinstance(value, float):
        return None if math.isfinite(value) else path
    if isinstance(value, dict):
        members: Iterable[tuple[object, object]] = value.items()
    elif isinstance(value, list):
        members = enumerate(value)
    else:
        return None
    for name, member in members:
        if isinstance(member, dict | list | float) and (found := _not_finite(member, f"{path}/{name}")):
            return found
    return None


def _renderings(result: Mapping[str, Any], envelope: Mapping[str, Any]) -> Iterator[Finding]:
    texts = [block["text"] for block in result.get("content") or [] if isinstance(block, dict) and "text" in block]
    if not texts:
        yield Finding(code="no_text", message="the result has no text block", requirement="MCP-006", strength="SHOULD")
    for text in map(str, texts):
        try:
            rendering = parse_strict(text)
        except ValueError as reason:
            yield _not_json(text, reason)
            continue
        if not isinstance(rendering, dict | list):
            yield _prose(text)
        elif not same_json(rendering, envelope):
            yield Finding(
                code="renderings_differ",
                message="the text block and structuredContent are different",
                requirement="MCP-006",
                evidence=text[:400],
            )


def _not_json(text: str, reason: ValueError) -> Finding:
    # What begins like an object is meant to be JSON, as a program that looks for JSON in the text would take it.
    if not text.lstrip().startswith("{"):
        return _prose(text)
    return Finding(
        code="text_not_json",
        message=f"the text block is not strict JSON: {reason}",
        requirement="ENV-003",
        evidence=text[:400],
    )


def _prose(text: str) -> Finding:
    return Finding(
        code="prose_text",
        message="a text block should be the JSON of structuredContent, it is prose",
        requirement="MCP-006",
        evidence=text[:400],
        strength="SHOULD",
    )


def _error_faults(error: Mapping[str, object]) -> Iterator[Finding]:
    code = error.get("code")
    entry = registry().get(code) if isinstance(code, str) else None
    if entry is None and not str(code).startswith("x_"):
        yield Finding(code="unknown_code", message=f"error code {code!r} is not in the registry", requirement="ERR-001")
    if code == "internal_error":
        yield Finding(
            code="internal_error",
            message=f"the adapter reports a bug of its own: {error.get('message')}",
            requirement="ERR-001",
        )
    if leak := _LEAKS.search(str(error.get("message"))[:_SEARCHED]):
        yield Finding(
            code="leaky_message",
            message=f"the error message leaks internals: {leak.group()!r}",
            requirement="ENV-006",
        )
    outcome = error.get("outcome")
    if entry is None:
        if error.get("class") in _REFUSED_HERE and outcome in _MAY_HAVE_HAPPENED:
            yield Finding(
                code="impossible_outcome",
                message=f"an error of the class {error['class']} is refused by the adapter itself, its outcome is {outcome!r}",
                requirement="ERR-006",
            )
        return
    if error.get("class") not in entry.classes:
        yield Finding(
            code="wrong_class",
            message=f"error class of {code} should be {' or '.join(entry.classes)}, it is {error.get('class')!r}",
            requirement="ERR-001",
        )
    retryable = error.get("retryable")
    if isinstance(retryable, bool) and not entry.allows_retryable(retryable):
        yield Finding(code="wrong_retryable", message=f"retryable is {retryable} for {code}", requirement="ERR-001")
    if isinstance(outcome, str) and not entry.allows_outcome(outcome):
        yield Finding(
            code="impossible_outcome",
            message=f"error outcome of {code} should be {' or '.join(entry.outcomes)}, it is {outcome!r}",
            requirement="ERR-006",
        )


def _meta_faults(meta: Mapping[str, object], measured_ms: float | None, delay_ms: float) -> Iterator[Finding]:
    claimed = meta.get("latency_ms")
    if isinstance(claimed, int | float) and not isinstance(claimed, bool):
        # The adapter measures a part of the time that the kit measures.
        if measured_ms is not None and claimed > measured_ms + _CLOCK_MS:
            yield Finding(
                code="latency_too_long",
                message=f"meta.latency_ms says {claimed} ms, the whole call took {measured_ms:.3f} ms",
                requirement="ENV-004",
            )
        if delay_ms and claimed < delay_ms - _ROUNDING_MS:
            yield Finding(
                code="latency_too_short",
                message=f"meta.latency_ms says {claimed} ms, the device alone took {delay_ms:.3f} ms",
                requirement="ENV-004",
            )
    endpoint = meta.get("endpoint")
    if isinstance(endpoint, str):
        if "@" in endpoint.partition("://")[2].partition("/")[0]:
            yield Finding(code="credentials", message="meta.endpoint carries user information", requirement="KEY-001")
        elif not _ENDPOINT.fullmatch(endpoint):
            yield Finding(
                code="endpoint",
                message=f"meta.endpoint should be scheme://host:port, or scheme:///path for a serial line, it is {endpoint!r}",
                requirement="ENV-006",
            )
    started = meta.get("started_at")
    if isinstance(started, str) and not _is_utc(started):
        yield Finding(
            code="started_at",
            message=f"meta.started_at should be an RFC 3339 time in UTC, it is {started!r}",
            requirement="ENC-007",
        )


def _is_utc(text: str) -> bool:
    # RFC 3339, section 4: an offset of zero is UTC as well as its abbreviation.
    if "T" not in text or not text.endswith(("Z", "+00:00", "-00:00")):
        return False
    try:
        datetime.fromisoformat(text)
    except ValueError:
        return False
    return True


def _contradictions(meta: Mapping[str, object], error: Mapping[str, object]) -> Iterator[Finding]:
    """Judge what contradicts ``attempts: 0``: nothing left the process, so nothing came back and nothing can have happened."""
    if meta.get("attempts") != 0:
        return
    if meta.get("source") == "device":
        yield Finding(
            code="source_without_exchange",
            message="meta.source is 'device' although meta.attempts is 0",
            requirement="ENV-008",
        )
    if error.get("outcome") in ("partial", "applied") or (
        error.get("outcome") == "unknown" and error.get("code") != "internal_error"
    ):
        yield Finding(
            code="outcome_without_attempt",
            message=f"error outcome is {error['outcome']!r} although meta.attempts is 0",
            requirement="ERR-006",
        )
