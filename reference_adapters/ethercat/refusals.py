"""What a slave answers instead of doing what was asked for, as codes of the registry with messages that help."""

from __future__ import annotations

from ..core import AdapterError, Call

__all__ = ["refusal", "state_refused"]

# SDO abort codes (CiA 301, section 7.2.4.3.17).
_ABORTS = {
    0x05040000: ("timeout", "the slave gave the transfer up"),
    0x05040001: ("protocol_error", "the slave does not know the SDO command"),
    0x05040005: ("device_busy", "the slave is out of memory"),
    0x06010000: ("unsupported_operation", "the slave does not offer this access"),
    0x06010001: ("not_readable", "the object can only be written"),
    0x06010002: ("not_writable", "the object can only be read"),
    0x06020000: ("illegal_address", "the slave has no such object"),
    0x06040041: ("not_writable", "the object cannot be mapped"),
    0x06060000: ("device_failure", "the slave reports an error of its hardware"),
    0x06070010: ("type_mismatch", "the object has another length; check data_type"),
    0x06070012: ("type_mismatch", "the object is shorter; check data_type"),
    0x06070013: ("type_mismatch", "the object is longer; check data_type"),
    0x06090011: ("illegal_address", "the object has no such subindex"),
    0x06090030: ("illegal_value", "the slave does not take this value"),
    0x06090031: ("illegal_value", "the value is too high for the slave"),
    0x06090032: ("illegal_value", "the value is too low for the slave"),
    0x08000020: ("device_busy", "the slave cannot transfer or store the value now"),
    0x08000021: ("device_busy", "the slave is controlled locally and does not store the value"),
    0x08000022: ("session_error", "the slave does not store the value in its present state"),
}
_GENERAL = ("device_failure", "the slave refuses, for a reason of its own")
# AL status codes (ETG.1000.6, table 11).
_STATES = {
    0x0000: ("session_error", "the slave is in a state without process data; set_slave_state takes it to SAFEOP"),
    0x0011: ("invalid_input", "the slave cannot go to this state from the one that it is in"),
    0x0016: ("config_error", "the slave does not take its mailbox configuration"),
    0x001B: ("session_error", "the watchdog of the slave has expired"),
    0x001D: ("config_error", "the slave does not take the configuration of its outputs"),
    0x001E: ("config_error", "the slave does not take the configuration of its inputs"),
}
_OF_STATE = ("device_failure", "the slave refuses the state")


def refusal(call: Call, code: int) -> AdapterError:
    """Return the error for an SDO abort code."""
    call.trace["abort_code"] = f"{code:08X}"
    known, meaning = _ABORTS.get(code, _GENERAL)
    details = {"abort_code": f"{code:08X}"}
    outcome = "rejected" if call.writes else "not_applicable"
    return AdapterError(known, f"{meaning} (SDO abort {code:08X})", outcome=outcome, details=details)


def state_refused(call: Call, code: int, state: str) -> AdapterError:
    """Return the error for an AL status code, of a slave that stays in a state."""
    call.trace["al_status"] = code
    known, meaning = _STATES.get(code, _OF_STATE)
    # It takes no outputs in that state, and was sent none.
    outcome = "not_sent" if call.writes else "not_applicable"
    message = f"{meaning} (AL status {code:04X}); it is in {state}"
    return AdapterError(known, message, outcome=outcome, details={"al_status": f"{code:04X}", "state": state})
