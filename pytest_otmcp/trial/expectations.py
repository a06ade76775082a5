"""Expectations of tasks about replies. The oracles of ``protocols`` judge what reached the device.

Pure: functions from observations to findings, no state, no I/O; a stored history can be judged again.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence

from ..core.error_registry import registry
from ..core.finding import Finding
from ..core.strict_json import same_json
from ..protocols.protocol import BOUNDS, GOVERNANCE, LAUNCHES
from ..protocols.registry import protocols
from ..subject.command import SAYS
from .reply import Reply

__all__ = ["failed", "succeeded"]

_DECIMALS = range(6)
_AT_A_GLANCE = 16
"""Elements of a list that a sentence may repeat."""
_OWN_LIMIT = re.compile(r"\brunaway\b|\brate[ _-]?limit|\btoo many (?:calls|requests)\b|\bthrottl", re.IGNORECASE)
"""Words of adapters that refuse a call for the number of calls before it."""


def succeeded(reply: Reply, *, requirement: str | None = None, **outputs: object) -> list[Finding]:
    """Expect that the call claims success and that its outputs equal ``outputs``.

    What the answer of a named command says is held against what was asked for, whether ``outputs`` name it or not.
    An output that the subject's binding does not say how to find is not judged here; the device still is.

    Args:
        requirement: id of the requirement that the call breaks otherwise; None is that of the operation.
        outputs: the outputs, by name.
    """
    of_operation = protocols()[reply.adapter].operations[reply.operation].requirement
    requirement = requirement or ("RD-008" if reply.meaning else of_operation)
    if reply.success is False and _is_own_limit(reply):
        return [
            Finding(
                code="own_limit",
                message=f"{reply.label}: expected success, the adapter refuses further calls: {_outcome(reply)}",
                evidence=_shown(reply.envelope),
            )
        ]
    if reply.success is not True:
        return [
            Finding(
                code="not_successful",
                message=f"{reply.label}: expected success, got {_outcome(reply)}",
                requirement=requirement,
                evidence=_shown(reply.envelope),
            )
        ]
    return [*_said_otherwise(reply), *_differences(reply, outputs, requirement)]


def _said_otherwise(reply: Reply) -> list[Finding]:
    """Return what the answer of a named command says of its arguments, or of its effect, that is not what was asked for."""
    return [
        Finding(
            code="wrong_value",
            message=f"{reply.label}: {_otherwise(name.removeprefix(SAYS), asked, reply.outputs.get(name))}",
            requirement="WR-014",
            evidence=_shown(reply.envelope),
        )
        for name, asked in reply.asked.items()
        if not same_json(asked, reply.outputs.get(name))
    ]


def _otherwise(name: str, asked: object, found: object) -> str:
    says = "nothing" if found is None else _shown(found)
    return f"{name} should be {_shown(asked)}, the reply says {says} by the subject file"


def _differences(reply: Reply, outputs: Mapping[str, object], requirement: str | None) -> list[Finding]:
    """Return the outputs that are not as expected, of those that the binding knows how to find."""
    return [
        Finding(
            code="wrong_value",
            message=f"{reply.label}: {_differing(name, expected, reply.outputs[name], meant=reply.meaning)}",
            requirement="ENC-003" if _rounded(expected, reply.outputs[name]) else requirement,
            evidence=_shown(reply.envelope),
        )
        for name, expected in outputs.items()
        if name in reply.outputs and not same_json(expected, reply.outputs[name])
    ]


def _is_own_limit(reply: Reply) -> bool:
    """Tell whether a failure is for how often the adapter is called: it says nothing about the rule that the call is for.

    A launch that was told limits has them on purpose, and a device that refuses a request may have a limit as well.
    """
    if reply.variant in (LAUNCHES[BOUNDS], LAUNCHES[GOVERNANCE]) or reply.member("error", "outcome") == "rejected":
        return False
    said = reply.member("error", "message")
    return reply.error_code == "rate_limited" or (isinstance(said, str) and _OWN_LIMIT.search(said) is not None)


def _differing(name: str, expected: object, found: object, *, meant: bool) -> str:
    """Say in what an output differs; of a long list its length, or its first element that does: two long lists look alike."""
    if meant:
        # The adapter's own words are another number, or no number at all; they are beside the finding.
        held, says = (one[0] if isinstance(one, list) and len(one) == 1 else one for one in (expected, found))
        what = "nothing that the subject file knows" if says is None else f"that it holds {_shown(says)}"
        return f"the device holds {_shown(held)}, by the subject file the reply means {what}"
    if isinstance(expected, list) and isinstance(found, list) and len(expected) > _AT_A_GLANCE:
        if len(expected) != len(found):
            return f"{name} should be a list of {len(expected)}, the reply says a list of {len(found)}"
        place = next(index for index, pair in enumerate(zip(expected, found, strict=True)) if not same_json(*pair))
        return (
            f"{name}, element {place} of {len(expected)}, should be {_shown(expected[place])}, "
            f"the reply says {_shown(found[place])}"
        )
    return f"{name} should be {_shown(expected)}, the reply says {_shown(found)}"


def _rounded(expected: object, found: object) -> bool:
    """Tell whether what was found is the expected value, or several of them, with fewer decimals."""
    if isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        differing = [pair for pair in zip(expected, found, strict=True) if not same_json(*pair)]
        return bool(differing) and all(_rounded(*pair) for pair in differing)
    if not isinstance(expected, float) or not isinstance(found, float):
        return False
    return any(round(expected, decimals) == found for decimals in _DECIMALS)


def failed(
    reply: Reply,
    *codes: str,
    outcome: str | Sequence[str] | None = None,
    trace: Mapping[str, object] | None = None,
    requirement: str = "ERR-001",
    code_requirement: str | None = None,
) -> list[Finding]:
    """Expect that the call is refused in an envelope, with one of ``codes``.

    Args:
        codes: acceptable error codes.
        outcome: what ``error.outcome`` must be; of a sequence, one of its values.
        trace: members that ``meta.trace`` must have; a mapping is compared member by member.
        requirement: id of the requirement that the call breaks when it claims success.
        code_requirement: id of the requirement that another code breaks; None is the same.

    For an adapter without envelopes only this is judged: that its answer is a refusal and, where the subject file
    classifies the answer, the code.
    """
    if reply.success is not False:
        claim = "it claims success" if reply.success else f"got {_outcome(reply)}"
        refusal = "an error envelope" if reply.native else "a failure"
        return [
            Finding(
                code="not_refused",
                message=f"{reply.label}: expected {refusal} with code {' or '.join(codes)}, {claim}",
                requirement=requirement,
                evidence=_shown(reply.envelope),
            )
        ]
    findings = []
    envelope = reply.envelope or {}
    error = envelope.get("error")
    # An envelope's error that is no object, or has no code of the registry, has been reported as such.
    comparable = _is_known(reply.error_code) if reply.native else not reply.unclassified
    if reply.error_code not in codes and comparable:
        findings.append(
            Finding(
                code="wrong_error_code",
                message=f"{reply.label}: error code should be {' or '.join(codes)}, it is {reply.error_code!r}",
                requirement=code_requirement or requirement,
                evidence=_shown(error),
            )
        )
    if not reply.native:
        return findings
    allowed = [outcome] if isinstance(outcome, str) else list(outcome or [])
    stated = _member(error, "outcome")
    if allowed and stated not in allowed and isinstance(error, Mapping):
        findings.append(
            Finding(
                code="wrong_outcome",
                message=f"{reply.label}: error outcome should be {' or '.join(allowed)}, it is {stated!r}",
                requirement="ERR-006",
                evidence=_shown(error),
            )
        )
    found_trace = _member(envelope.get("meta"), "trace") or {}
    if trace is not None and not _contains(found_trace, trace):
        findings.append(
            Finding(
                code="wrong_trace",
                message=f"{reply.label}: meta.trace should hold {_shown(trace)}, it is {_shown(found_trace)}",
                requirement="ENV-007",
            )
        )
    return findings


def _is_known(code: str | None) -> bool:
    return code is not None and (code in registry() or code.startswith("x_"))


def _member(value: object, name: str) -> object:
    # An envelope's member that is not an object has been reported as such.
    return value.get(name) if isinstance(value, Mapping) else None


def _contains(found: object, expected: object) -> bool:
    if isinstance(expected, Mapping):
        return isinstance(found, Mapping) and all(
            name in found and _contains(found[name], value) for name, value in expected.items()
        )
    return same_json(expected, found)


def _outcome(reply: Reply) -> str:
    if not reply.answered:
        return "no reply"
    if reply.envelope is None:
        return "no envelope"
    error = reply.envelope.get("error")
    if isinstance(error, dict):
        return f"error {error.get('code')!r}: {str(error.get('message'))[:200]}"
    return "no success"


def _shown(value: object) -> str:
    text = json.dumps(value, ensure_ascii=False, default=repr)
    return text if len(text) <= 400 else text[:400] + "…"
