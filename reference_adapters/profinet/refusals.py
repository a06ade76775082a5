"""What a device answers instead of doing what was asked for, as codes of the registry with messages that help."""

from __future__ import annotations

from ..core import AdapterError, Call

__all__ = ["dcp_refusal", "refusal"]

_RECORD = {
    0xA0: ("device_failure", "the device cannot read it now (read error)"),
    0xA1: ("device_failure", "the device cannot write it now (write error)"),
    0xA2: ("device_failure", "the module has failed"),
    0xA7: ("device_busy", "the device is busy"),
    0xA9: ("unsupported_operation", "the device does not support this"),
    0xB0: ("illegal_address", "the subslot has no such index"),
    0xB1: ("type_mismatch", "the record has another length"),
    0xB2: ("illegal_address", "the device has no such slot or subslot"),
    0xB3: ("type_mismatch", "the record has another type"),
    0xB4: ("illegal_address", "the device has no such area"),
    0xB5: ("session_error", "the device is in another state than this needs"),
    0xB6: ("access_denied", "the device denies the access"),
    0xB7: ("illegal_value", "the record cannot have this value (invalid range)"),
    0xB8: ("illegal_value", "the record cannot have this value (invalid parameter)"),
    0xB9: ("type_mismatch", "the record has another type"),
    0xC0: ("device_busy", "another access is under way"),
    0xC1: ("device_busy", "another access is under way"),
    0xC2: ("device_busy", "the device has no room for the request now"),
    0xC3: ("device_busy", "the device has no room for the request now"),
}
_CMRPC, _NO_RESOURCES, _UNKNOWN_RELATION = 0x40, 4, 5
_DCP = {
    1: ("unsupported_operation", "the station does not have this option"),
    2: ("unsupported_operation", "the station does not have this suboption"),
    3: ("illegal_value", "the station cannot have this value"),
    4: ("device_failure", "the station could not store it"),
    5: ("device_busy", "the station cannot do this now"),
    6: ("device_busy", "the station is in operation"),
}


def refusal(call: Call, status: int) -> AdapterError:
    """Return the error for a PNIO status (IEC 61158-6-10, 5.2.6)."""
    _, decode, code, second = status.to_bytes(4)
    outcome = "rejected"
    if decode == 0x80:
        name = f"{code:02X}"
        kind, meaning = _RECORD.get(code, ("protocol_error", "the device refuses with an error that is not known"))
    elif code == _CMRPC and second == _NO_RESOURCES:
        name, outcome = f"CMRPC-{second:02X}", "not_sent"
        kind, meaning = "access_denied", "another controller has the device"
    elif code == _CMRPC and second == _UNKNOWN_RELATION:
        name = f"CMRPC-{second:02X}"
        kind, meaning = "session_error", "the device does not know the relation any more"
    else:
        name = f"CM-{code:02X}"
        kind, meaning = "protocol_error", "the device refuses the relation"
    call.trace["pnio_error"] = name
    message = f"{meaning} (PNIO status {status:08X})"
    return AdapterError(kind, message, outcome=outcome if call.writes else None)


def dcp_refusal(result: int) -> AdapterError:
    """Return the error for the result of a DCP Set, which is not 0."""
    kind, meaning = _DCP.get(result, ("protocol_error", "the station refuses with a result that is not known"))
    return AdapterError(kind, f"{meaning} (DCP result {result})", outcome="rejected")
