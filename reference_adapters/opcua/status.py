"""OPC UA status codes (OPC 10000-4, 7.39) as error codes of the envelope."""

from __future__ import annotations

from typing import Any

from asyncua import ua

from ..core import AdapterError

__all__ = ["quality", "refusal", "trace_status"]

# Symbol to (error code, outcome of a write). A Bad code that is not listed is a device_failure of unknown outcome.
_CODES: dict[str, tuple[str, str]] = {
    "BadNodeIdInvalid": ("invalid_input", "rejected"),
    "BadNodeIdUnknown": ("illegal_address", "rejected"),
    "BadAttributeIdInvalid": ("illegal_address", "rejected"),
    "BadIndexRangeInvalid": ("invalid_input", "rejected"),
    "BadIndexRangeNoData": ("illegal_address", "rejected"),
    "BadTypeMismatch": ("type_mismatch", "rejected"),
    "BadOutOfRange": ("illegal_value", "rejected"),
    "BadNotWritable": ("not_writable", "rejected"),
    "BadNotReadable": ("not_readable", "rejected"),
    "BadWriteNotSupported": ("unsupported_operation", "rejected"),
    "BadNotSupported": ("unsupported_operation", "rejected"),
    "BadServiceUnsupported": ("unsupported_operation", "rejected"),
    "BadUserAccessDenied": ("access_denied", "rejected"),
    "BadIdentityTokenInvalid": ("auth_failed", "not_sent"),
    "BadIdentityTokenRejected": ("auth_failed", "not_sent"),
    "BadSecurityChecksFailed": ("tls_error", "not_sent"),
    "BadCertificateUntrusted": ("tls_error", "not_sent"),
    "BadCertificateTimeInvalid": ("tls_error", "not_sent"),
    "BadCertificateHostNameInvalid": ("tls_error", "not_sent"),
    "BadCertificateInvalid": ("tls_error", "not_sent"),
    "BadCertificateUriInvalid": ("tls_error", "not_sent"),
    "BadCertificateUseNotAllowed": ("tls_error", "not_sent"),
    "BadCertificateRevoked": ("tls_error", "not_sent"),
    "BadSecurityPolicyRejected": ("tls_error", "not_sent"),
    "BadMethodInvalid": ("illegal_address", "rejected"),
    "BadArgumentsMissing": ("invalid_input", "rejected"),
    "BadInvalidArgument": ("invalid_input", "rejected"),
    "BadTooManyArguments": ("invalid_input", "rejected"),
    "BadTooManyOperations": ("limit_exceeded", "rejected"),
    "BadNothingToDo": ("invalid_input", "rejected"),
    "BadRequestTooLarge": ("limit_exceeded", "rejected"),
    "BadResponseTooLarge": ("limit_exceeded", "rejected"),
    "BadEncodingLimitsExceeded": ("limit_exceeded", "not_sent"),
    "BadInvalidState": ("device_busy", "rejected"),
    "BadResourceUnavailable": ("device_busy", "rejected"),
    "BadTooManySessions": ("device_busy", "not_sent"),
    "BadServerHalted": ("connect_failed", "rejected"),
    "BadShutdown": ("connection_lost", "unknown"),
    "BadTimeout": ("timeout", "unknown"),
    "BadRequestTimeout": ("timeout", "unknown"),
    "BadCommunicationError": ("connection_lost", "unknown"),
    "BadConnectionClosed": ("connection_lost", "unknown"),
    "BadNoCommunication": ("bad_quality", "unknown"),
    "BadNotConnected": ("bad_quality", "rejected"),
    "BadWaitingForInitialData": ("bad_quality", "rejected"),
    "BadSensorFailure": ("bad_quality", "rejected"),
    "BadOutOfService": ("bad_quality", "rejected"),
    "BadSessionIdInvalid": ("session_error", "rejected"),
    "BadSessionClosed": ("session_error", "rejected"),
    "BadSessionNotActivated": ("session_error", "rejected"),
    "BadSecureChannelIdInvalid": ("session_error", "rejected"),
    "BadSecureChannelClosed": ("session_error", "unknown"),
    "BadDecodingError": ("protocol_error", "unknown"),
    "BadUnknownResponse": ("protocol_error", "unknown"),
    "BadNoContinuationPoints": ("device_busy", "rejected"),
    "BadContinuationPointInvalid": ("session_error", "rejected"),
}


def trace_status(status: ua.StatusCode) -> dict[str, Any]:
    """Return ``meta.trace.status_code``: the 32-bit value as it was on the wire, and its symbol."""
    return {"value": status.value, "symbol": status.name}


def quality(status: ua.StatusCode) -> str:
    """Return ``good``, ``uncertain`` or ``bad`` from the two severity bits; both bits set is bad."""
    return ("good", "uncertain", "bad", "bad")[status.value >> 30]


def refusal(
    status: ua.StatusCode,
    *,
    writes: bool,
    changes: bool = False,
    field: str | None = None,
    details: dict[str, Any] | None = None,
) -> AdapterError:
    """Return the error for an operation that the server answered with a Bad status.

    Args:
        status: the Bad status.
        writes: the tool changes the state of the plant.
        changes: the operation was the Write or Call itself, not one of the questions before it.
        field: JSON Pointer to the argument that named the operation's target.
        details: further information of the server.
    """
    code, outcome = _CODES.get(status.name, ("device_failure", "unknown"))
    return AdapterError(
        code,
        f"the server answered {status.name}",
        outcome=outcome if changes else "not_sent" if writes else "not_applicable",
        field=field,
        details=details,
    )
