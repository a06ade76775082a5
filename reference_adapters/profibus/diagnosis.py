"""The diagnosis of a slave in the standard's names (IEC 61158-6-3, Slave_Diag)."""

from __future__ import annotations

from dataclasses import dataclass

from ..core import AdapterError

__all__ = ["NO_MASTER", "Diagnosis", "diagnosis_of"]

NO_MASTER = 255
"""Address of the master of a slave that no master has parameterised."""

_STATUS_1 = (
    "station_non_existent",
    "station_not_ready",
    "cfg_fault",
    "ext_diag",
    "not_supported",
    "invalid_slave_response",
    "prm_fault",
    "master_lock",
)
# Bit 2 of the second byte is always one.
_STATUS_2 = ("prm_req", "stat_diag", None, "wd_on", "freeze_mode", "sync_mode", None, "deactivated")
_STATUS_3 = (*(None,) * 7, "ext_diag_overflow")
_HEAD = 6


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What a slave says of itself.

    Attributes:
        status: names of the bits that are set.
        master: address of the master that has parameterised it, :data:`NO_MASTER` for none.
        ident: its ident number.
        extended: the device's own diagnosis.
    """

    status: tuple[str, ...]
    master: int
    ident: int
    extended: bytes

    def has(self, *names: str) -> bool:
        """Tell whether any of these bits is set."""
        return any(name in self.status for name in names)


def diagnosis_of(content: bytes) -> Diagnosis:
    """Return the diagnosis that the data of an answer is.

    Raises:
        AdapterError: it is too short.
    """
    if len(content) < _HEAD:
        raise AdapterError("protocol_error", f"a diagnosis has at least {_HEAD} bytes")
    status = tuple(
        name
        for byte, names in zip(content, (_STATUS_1, _STATUS_2, _STATUS_3), strict=False)
        for bit, name in enumerate(names)
        if name is not None and byte >> bit & 1
    )
    return Diagnosis(
        status=status, master=content[3], ident=int.from_bytes(content[4:6], "big"), extended=content[_HEAD:]
    )
