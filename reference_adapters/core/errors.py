"""The error registry, and the exception with which a tool refuses.

``outcome`` is what a boolean cannot say: whether a state-changing request may have been executed.
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
    "access_denied": ("device", False, False),
    "rate_limited": ("device", True, True),
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

_NOTHING_SENT = frozenset({"validation", "policy"})


class AdapterError(Exception):
    """A tool call that did not succeed.

    Attributes:
        code: a key of :data:`REGISTRY`.
        message: one actionable sentence. Never with text that came from the device.
        outcome: ``not_sent``, ``rejected``, ``unknown``, ``partial`` or ``applied``; None lets the call decide from
            what it knows to have been sent.
        field: JSON Pointer to the argument that is at fault.
        allowed: the bound or set that was violated.
        details: further facts.
        partial: what succeeded, of a call with several items.
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
    ) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.outcome = outcome
        self.field = field
        self.allowed = allowed
        self.details = details
        self.partial = partial

    def as_error(self, *, writes: bool, sent: bool) -> dict[str, Any]:
        """The envelope's ``error`` member.

        Args:
            writes: the tool changes state.
            sent: a state-changing request may have left.
        """
        kind, retry_read, retry_write = REGISTRY[self.code]
        if self.outcome is not None:
            outcome = self.outcome
        elif kind in _NOTHING_SENT or (writes and not sent):
            outcome = "not_sent"
        elif not writes:
            outcome = "not_applicable"
        else:
            outcome = "unknown" if kind != "device" else "rejected"
        if kind == "validation" and outcome == "rejected":
            kind = "device"
        error: dict[str, Any] = {
            "code": self.code,
            "class": kind,
            "message": self.message[:500],
            # What certainly did not happen may simply be repeated, if repeating can help at all.
            "retryable": retry_write if writes else retry_read,
            "outcome": outcome,
        }
        for name in ("field", "allowed", "details"):
            if getattr(self, name) is not None:
                error[name] = getattr(self, name)
        return error
