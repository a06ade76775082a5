"""What a controller answers instead of doing what was asked for, as codes of the registry with messages that help."""

from __future__ import annotations

from ..core import AdapterError, Call

__all__ = ["refusal"]

_RETURN_CODES = {
    0x01: ("device_failure", "unknown", "the controller reports a hardware fault"),
    0x03: ("access_denied", "rejected", "the controller does not allow access to this data block or area"),
    0x05: (
        "illegal_address",
        "rejected",
        "there is no such address; a data block with optimized access has no offsets, switch that off in its properties",
    ),
    0x06: ("type_mismatch", "rejected", "the controller does not support this data type here"),
    0x07: ("type_mismatch", "rejected", "the data does not fit the address's type"),
    0x0A: ("illegal_address", "rejected", "there is no such data block or area, or it is not loaded"),
}
_ERRORS = {
    0x8104: (
        "access_denied",
        "rejected",
        "the controller refuses the service: permit PUT/GET communication in its protection settings, or its protection level "
        "forbids it",
    ),
    0x8301: ("device_busy", "rejected", "the controller has too little memory for the request now"),
    0x8302: ("device_busy", "rejected", "the controller has too few resources for the request now"),
    0x8304: ("device_busy", "rejected", "the controller has too few resources for the request now"),
    0x8402: ("device_busy", "rejected", "the state of the controller does not allow the service now"),
    0x8500: ("protocol_error", "unknown", "the controller says that the request's frame is wrong"),
    0x8702: ("unsupported_operation", "rejected", "the controller does not offer this service"),
    0x8703: ("access_denied", "rejected", "the controller refuses access"),
    0xD401: ("unsupported_operation", "rejected", "the controller does not have this system status list"),
    0xD402: ("unsupported_operation", "rejected", "the controller does not have this index of the list"),
}
_UNKNOWN = ("protocol_error", "unknown", "the controller refuses with a code that is not known")


def refusal(call: Call, *, error: int | None = None, return_code: int | None = None) -> AdapterError:
    """Return the error for a refusal, by the header's error (or that of user data) or by a variable's return code."""
    if error is not None:
        call.trace["error_code"] = error
        code, outcome, meaning = _ERRORS.get(error, _UNKNOWN)
        shown = f"error {error:04X}"
    else:
        assert return_code is not None
        call.trace["return_code"] = return_code
        code, outcome, meaning = _RETURN_CODES.get(return_code, _UNKNOWN)
        shown = f"return code {return_code:02X}"
    return AdapterError(code, f"{meaning} ({shown})", outcome=outcome if call.writes else "not_applicable")
