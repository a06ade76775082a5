"""What a slave answers instead of doing what was asked for, as codes of the registry with messages that help."""

from __future__ import annotations

from ..core import AdapterError, Call

__all__ = ["refusal"]

_STATUS = {
    0x1: ("device_failure", "unknown", "the slave reports an error of its user interface (UE)"),
    0x2: ("device_busy", "rejected", "the slave has no resources for the telegram now (RR)"),
    0x3: (
        "session_error",
        "rejected",
        "the slave has not activated this service (RS): it does not offer it, or it is not parameterised for it any more",
    ),
    0x9: ("device_busy", "rejected", "the slave has no data ready (NR)"),
}
_UNKNOWN = ("protocol_error", "unknown", "the slave refuses with a status that is not known")


def refusal(call: Call, status: int) -> AdapterError:
    """Return the error for the function code of an answer (IEC 61158-4-3: its status)."""
    call.trace["fdl_status"] = status
    code, outcome, meaning = _STATUS.get(status, _UNKNOWN)
    return AdapterError(
        code, f"{meaning} (FDL status {status:X})", outcome=outcome if call.writes else "not_applicable"
    )
