"""What a device says when it refuses: errors by class and code, reject and abort reasons (ASHRAE 135, clauses 18 and 20.1)."""

from __future__ import annotations

from bacpypes3.apdu import AbortPDU, ErrorPDU, RejectPDU

from ..core import AdapterError, Call

__all__ = ["refusal"]

# Error class and code to error code, outcome of a write, meaning.
_ERRORS = {
    (0, 2): ("device_busy", "rejected", "the device is busy; try again later"),
    (0, 25): ("device_failure", "unknown", "the device has an operational problem"),
    (1, 31): ("illegal_address", "rejected", "the device has no such object"),
    (2, 9): ("type_mismatch", "rejected", "the property has another datatype"),
    (2, 27): ("not_readable", "rejected", "the device does not let this property be read"),
    (2, 32): ("illegal_address", "rejected", "the object has no such property"),
    (2, 37): ("illegal_value", "rejected", "the device refuses the value"),
    (2, 40): ("not_writable", "rejected", "the device does not let this property be written"),
    (2, 42): ("illegal_address", "rejected", "the array has no such element"),
    (2, 50): ("illegal_address", "rejected", "the property is no array"),
    (5, 29): ("access_denied", "rejected", "the device denies the access"),
}
_RESOURCES = 3
_REJECTS = {
    9: ("unsupported_operation", "the device does not have this service"),
    6: ("illegal_value", "a parameter of the request is out of range"),
}
_ABORTS = {
    4: ("limit_exceeded", "the answer does not fit into one message, and the device sends no segments"),
    11: ("limit_exceeded", "the message is too long for the device"),
    9: ("device_busy", "the device is out of resources; try again later"),
}


def refusal(call: Call, error: ErrorPDU | RejectPDU | AbortPDU) -> AdapterError:
    """Return the failure that an Error, Reject or Abort PDU means; the call's trace gets its numbers."""
    if isinstance(error, (RejectPDU, AbortPDU)):
        reason = int(error.apduAbortRejectReason)
        is_reject = isinstance(error, RejectPDU)
        call.trace["reject_reason" if is_reject else "abort_reason"] = reason
        known = _REJECTS if is_reject else _ABORTS
        code, meaning = known.get(reason, ("protocol_error", "the device rejects the request"))
        name = "reject" if is_reject else "abort"
        outcome = "unknown" if code == "protocol_error" else "rejected"
        text = f"{meaning} ({name} reason {reason})"
    else:
        pair = int(error.errorClass), int(error.errorCode)
        call.trace["error_class"], call.trace["error_code"] = pair
        if pair[0] == _RESOURCES and pair not in _ERRORS:
            code, outcome, meaning = "limit_exceeded", "rejected", "the device has no room for this"
        else:
            code, outcome, meaning = _ERRORS.get(pair, ("protocol_error", "unknown", "the device reports an error"))
        text = f"{meaning} (error class {pair[0]}, code {pair[1]})"
    return AdapterError(code, text, outcome=outcome if call.writes else "not_applicable")
