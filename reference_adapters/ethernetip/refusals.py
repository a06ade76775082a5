"""What a controller answers instead of doing what was asked for, as codes of the registry with messages that help.

The general status and the extended ones are those of CIP (ODVA, volume 1, appendix B) and of Logix controllers (Rockwell 1756-PM020).
"""

from __future__ import annotations

from ..core import AdapterError, Call

__all__ = ["encapsulation_refusal", "open_refusal", "refusal"]

_NO_TAG = "the controller has no such tag or member, or does not let clients see it; get_tag_list lists its tags"
_BUSY = "the controller has too few resources for the request now"

_STATUS = {
    0x01: ("session_error", "rejected", "the controller does not know the connection any more"),
    0x02: ("device_busy", "rejected", _BUSY),
    0x03: ("illegal_value", "rejected", "the controller refuses a value of the request"),
    0x04: ("illegal_address", "rejected", _NO_TAG),
    0x05: ("illegal_address", "rejected", _NO_TAG),
    0x06: ("limit_exceeded", "rejected", "the answer does not fit into one message; ask for fewer elements at once"),
    0x08: ("unsupported_operation", "rejected", "the controller does not offer this service here"),
    0x09: ("illegal_value", "rejected", "the controller refuses the value of an attribute"),
    0x0A: ("unsupported_operation", "rejected", "the controller refuses one of the attributes"),
    0x0C: ("device_busy", "rejected", "the state of the controller does not allow the service now"),
    0x0E: ("not_writable", "rejected", "the controller does not allow setting this"),
    0x0F: ("access_denied", "rejected", "the controller does not allow it: see the tag's external access"),
    0x10: ("device_busy", "rejected", "the state of the controller, or its key switch, does not allow the service now"),
    0x11: ("limit_exceeded", "rejected", "the answer is too large for the controller; ask for less at once"),
    0x13: ("protocol_error", "unknown", "the controller says that the request has too little data"),
    0x14: ("illegal_address", "rejected", "the controller has no such attribute"),
    0x15: ("protocol_error", "unknown", "the controller says that the request has too much data"),
    0x16: ("illegal_address", "rejected", "the controller has no such object"),
    0x20: ("illegal_value", "rejected", "the controller refuses a value of the request"),
    0x26: ("protocol_error", "unknown", "the controller says that the path of the request is wrong"),
}
_GENERAL_STATUS = 0xFF
_EXTENDED = {
    0x2104: ("illegal_address", "rejected", "the address is beyond the end of the tag"),
    0x2105: ("illegal_address", "rejected", "the elements reach beyond the end of the array"),
    0x2107: ("type_mismatch", "rejected", "the tag has another type by now; read it again"),
}
_OPENING = 0x01
_TOO_MANY = 0x0113
_WRONG_ROUTE = (0x0204, 0x0311, 0x0312, 0x0315)
_ENCAPSULATION = {
    0x01: ("unsupported_operation", "rejected", "the device does not offer this command"),
    0x02: ("device_busy", "rejected", "the device has too little memory for the request now"),
    0x64: ("session_error", "rejected", "the device does not know the session any more"),
}
_UNKNOWN = ("protocol_error", "unknown", "the controller refuses with a code that is not known")


def refusal(call: Call, status: int, extended: int | None) -> AdapterError:
    """Return the error for an answer with this general status, and with this extended one where it has one."""
    call.trace["status"] = status
    shown = f"status {status:02X}"
    known = _STATUS.get(status, _UNKNOWN)
    if extended is not None:
        call.trace["extended_status"] = extended
        shown += f", extended {extended:04X}"
        if status == _GENERAL_STATUS:
            known = _EXTENDED.get(extended, _UNKNOWN)
    return _error(call, known, shown)


def encapsulation_refusal(call: Call, status: int) -> AdapterError:
    """Return the error for an answer whose header has this status."""
    call.trace["encapsulation_status"] = status
    return _error(call, _ENCAPSULATION.get(status, _UNKNOWN), f"encapsulation status {status:02X}")


def _error(call: Call, known: tuple[str, str, str], shown: str) -> AdapterError:
    code, outcome, meaning = known
    if call.writes and not call.writes_sent:
        # What was refused is a question before the write.
        outcome = "not_sent"
    return AdapterError(code, f"{meaning} ({shown})", outcome=outcome if call.writes else "not_applicable")


def open_refusal(status: int, extended: int | None, slot: int) -> AdapterError:
    """Return the error for a refused Forward_Open."""
    shown = f"status {status:02X}" + ("" if extended is None else f", extended {extended:04X}")
    if status == _OPENING and extended == _TOO_MANY:
        message = f"the controller has no CIP connection left for this adapter; close other clients ({shown})"
        return AdapterError("device_busy", message, outcome="not_sent")
    if status == _OPENING and extended in _WRONG_ROUTE:
        message = f"there is no controller in slot {slot}; set ETHERNETIP_SLOT to the controller's ({shown})"
        return AdapterError("config_error", message, outcome="not_sent")
    return AdapterError("connect_failed", f"the controller refuses the CIP connection ({shown})", outcome="not_sent")
