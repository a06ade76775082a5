"""What an outstation says when it refuses: internal indications (IEEE 1815, clause 4.5) and the status of a command (annex A.8.1)."""

from __future__ import annotations

from dnp3.core.enums import CommandStatus
from dnp3.core.flags import IIN

from ..core import AdapterError, Call

__all__ = ["command_refused", "refused", "status_name"]

_INDICATIONS = (
    (IIN.NO_FUNC_CODE_SUPPORT, "unsupported_operation", "the outstation does not have this function"),
    (IIN.OBJECT_UNKNOWN, "illegal_address", "the outstation has no such objects"),
    (IIN.PARAMETER_ERROR, "illegal_address", "the outstation has no points of these indexes, or not all"),
    (IIN.ALREADY_EXECUTING, "device_busy", "the outstation is executing such a request already"),
)
_STATUSES = {
    1: ("session_error", "rejected", "the time between select and operate was too long; send the command again"),
    2: ("session_error", "rejected", "the outstation says that nothing was selected before; send the command again"),
    3: ("protocol_error", "unknown", "the outstation says that the command has a wrong form"),
    4: ("unsupported_operation", "rejected", "the point does not exist, or does not take this control code"),
    5: ("device_busy", "rejected", "the point is already active"),
    6: ("device_failure", "unknown", "the outstation reports a hardware fault"),
    7: ("access_denied", "rejected", "the point is switched to local control"),
    8: ("limit_exceeded", "rejected", "the outstation takes fewer objects at once"),
    9: ("access_denied", "rejected", "the outstation does not authorize the command"),
    10: ("access_denied", "rejected", "an automation of the outstation inhibits the command"),
    11: ("device_busy", "rejected", "the outstation has too few resources for the command now"),
    12: ("illegal_value", "rejected", "the value is outside of the range of the point"),
}
_UNKNOWN = ("protocol_error", "unknown", "the outstation refuses with a status that is not known")


def refused(call: Call, indications: int) -> AdapterError | None:
    """Return the failure that the internal indications of an answer mean; None where they mean none."""
    for bit, code, meaning in _INDICATIONS:
        if indications & bit:
            outcome = "rejected" if call.writes else "not_applicable"
            return AdapterError(code, f"{meaning} ({bit.name})", outcome=outcome)
    return None


def command_refused(call: Call, status: int) -> AdapterError:
    """Return the failure that the status of a command means."""
    code, outcome, meaning = _STATUSES.get(status, _UNKNOWN)
    return AdapterError(code, f"{meaning} (status {status}, {status_name(status)})", outcome=outcome)


def status_name(status: int) -> str:
    """Return the standard's name of a command's status."""
    return CommandStatus(status).name if status in CommandStatus.__members__.values() else "RESERVED"
