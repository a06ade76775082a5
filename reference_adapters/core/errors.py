"""The error registry, and the exception that a tool raises when a call fails.

``outcome`` says more than a boolean can: whether a state-changing request may have been executed.
"""

from __future__ import annotations

from typing import Any

__all__ = ["REGISTRY", "AdapterError"]

REGISTRY: dict[str, tuple[str, bool, bool]] = {
    # code: (class, may a read simply be repeated, may a write simply be repeated)
    "invalid_input": ("validation", False, False),
    "range_overflow": ("validation", False, False),
    "type_mismatch": ("validation", False, False),
    "limit_exceeded": ("validation", False, False),
    "unsupported_operation": ("validation", False, False),
    "config_error": ("internal", False, False),
    "writes_disabled": ("policy", False, False),
    "access_denied": ("policy", False, False),
    "approval_required": ("policy", False, False),
    "approval_denied": ("policy", False, False),
    "approval_expired": ("policy", False, False),
    "audit_unavailable": ("policy", False, False),
    "rate_limited": ("policy", True, True),
    "illegal_address": ("device", False, False),
    "illegal_value": ("device", False, False),
    "not_readable": ("device", False, False),
    "not_writable": ("device", False, False),
    "bad_quality": ("device", True, False),
    "device_failure": ("device", True, False),
    "device_busy": ("device", True, True),
    "accepted_pending": ("device", True, False),
    "gateway_path_unavailable": ("device", True, True),
    "gateway_target_no_response": ("device", True, False),
    "not_born": ("state", False, False),
    "verify_failed": ("device", False, False),
    "partial_failure": ("device", True, False),
    "connect_failed": ("transport", True, True),
    "dns_error": ("transport", True, True),
    "connection_lost": ("transport", True, False),
    "timeout": ("transport", True, False),
    "tls_error": ("transport", False, False),
    "auth_failed": ("transport", False, False),
    "session_error": ("transport", True, True),
    "protocol_error": ("protocol", True, False),
    "internal_error": ("internal", False, False),
}

# These sets decide the outcome of a write where the tool does not give one.
_NOTHING_SENT = frozenset({"validation", "policy", "state"})
_NEVER_CONNECTED = frozenset({"config_error", "connect_failed", "dns_error", "tls_error", "auth_failed"})
_MAYBE_BEGUN = frozenset({"accepted_pending", "device_failure", "gateway_target_no_response"})
# These are refusals by the adapter when nothing was sent, by the device otherwise.
_ALSO_FROM_DEVICES = frozenset(
    {"type_mismatch", "limit_exceeded", "unsupported_operation", "access_denied", "rate_limited"}
)
_MAX_MESSAGE = 500


class AdapterError(Exception):
    """A tool call that did not succeed.

    Attributes:
        code: a key of :data:`REGISTRY`.
        message: one sentence that tells the caller what to do differently. It must not contain text that came from the
            device: an assistant reads the message as the adapter's own words.
        outcome: ``not_sent``, ``rejected``, ``unknown``, ``partial`` or ``applied``; None lets the call derive it from
            the requests that were sent.
        field: JSON Pointer to the argument that is at fault.
        allowed: the bounds that were violated.
        details: further facts.
        partial: the results of a call with several items of which some failed.
        retry_after_ms: time after which repeating the call may succeed, where that is known.

    Raises:
        ValueError: the code is not in the registry, or the message is empty.
    """

    def __init__(
        self,
        code: str,
        message: str,
        *,
        outcome: str | None = None,
        field: str | None = None,
        allowed: dict[str, Any] | None = None,
        details: dict[str, Any] | None = None,
        partial: Any = None,
        retry_after_ms: int | None = None,
    ) -> None:
        super().__init__(message)
        if code not in REGISTRY or not message:
            raise ValueError(f"an error needs a message and a code of the registry, not {code!r}")
        self.code = code
        self.message = message
        self.outcome = outcome
        self.field = field
        self.allowed = allowed
        self.details = details
        self.partial = partial
        self.retry_after_ms = retry_after_ms

    def as_error(self, *, writes: bool, sent: bool) -> dict[str, Any]:
        """Return the envelope's ``error`` member.

        Args:
            writes: the tool changes state.
            sent: a state-changing request may have left.
        """
        kind, retry_read, retry_write = REGISTRY[self.code]
        outcome = self.outcome or _outcome(self.code, kind, writes=writes, sent=sent)
        if self.code in _ALSO_FROM_DEVICES and outcome in ("rejected", "not_applicable"):
            kind = "device"
        error: dict[str, Any] = {
            "code": self.code,
            "class": kind,
            "message": self.message[:_MAX_MESSAGE],
            # A write that certainly did not happen may be repeated like a read.
            "retryable": retry_write if writes and outcome != "not_sent" else retry_read,
            "outcome": outcome,
        }
        for name in ("field", "allowed", "details", "retry_after_ms"):
            if getattr(self, name) is not None:
                error[name] = getattr(self, name)
        return error


def _outcome(code: str, kind: str, *, writes: bool, sent: bool) -> str:
    if kind in _NOTHING_SENT or (writes and (not sent or code in _NEVER_CONNECTED)):
        return "not_sent"
    if not writes:
        return "not_applicable"
    if code == "verify_failed":
        return "applied"
    return "rejected" if kind == "device" and code not in _MAYBE_BEGUN else "unknown"
