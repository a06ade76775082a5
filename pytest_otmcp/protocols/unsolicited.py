"""What a device may not receive while nobody asks the adapter for a command. Pure.

An adapter that keeps a command which it has reported as failed, and delivers it when it can, does so in its own time. So the
journal is read between the items as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ..core.finding import Finding
from .modbus import oracle as modbus_oracle
from .mqtt import oracle as mqtt_oracle
from .opcua import oracle as opcua_oracle

__all__ = ["nothing_commanded"]

_ORACLES: Mapping[str, Callable[[Sequence[Mapping[str, Any]]], list[Finding]]] = {
    "modbus": modbus_oracle.no_state_changing_request,
    "mqtt": mqtt_oracle.no_command,
    "opcua": opcua_oracle.no_state_changing_service,
}


def nothing_commanded(protocol: str, entries: Sequence[Mapping[str, Any]]) -> list[Finding]:
    """The adapter sent the device of ``protocol`` nothing that commands the plant."""
    return _ORACLES[protocol](entries)
