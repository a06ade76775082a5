"""Defects of a BACnet adapter."""

from __future__ import annotations

from typing import Any

from ..core import Call
from .any_protocol import guard_after_sending
from .defect import Data, Handler, around, defect, succeeding

__all__ = ["DEFECTS", "told_as_asked"]

_WRITE = "write_property"
_LOWEST = 16


def told_as_asked(call: Call, arguments: Any) -> Data:
    return {
        **arguments.model_dump(include={"device_id", "object_type", "object_instance", "property_id", "value"}),
        "present_value": arguments.value,
        "priority": arguments.priority,
        "winning_priority": arguments.priority,
    }


@around(_WRITE)
async def at_the_lowest_priority(genuine: Handler, call: Call, arguments: Any) -> Data:
    data = await genuine(call, arguments.model_copy(update={"priority": _LOWEST}))
    return data


DEFECTS = (
    defect(
        "MU-02bac",
        "bacnet",
        "Every BACnet write goes to priority 16, whichever was asked for.",
        at_the_lowest_priority,
        "B3 B5 B6 FB5 SB2",
        "WR-001 WR-002",
    ),
    defect(
        "MU-14bac",
        "bacnet",
        "A BACnet write that the device acknowledges is told as done, although a higher priority wins.",
        succeeding(_WRITE, code="verify_failed", answer=told_as_asked),
        "B5",
        "WR-001",
    ),
    defect(
        "MU-20bac",
        "bacnet",
        "With writes disabled the WriteProperty is sent, and then denied.",
        guard_after_sending(_WRITE),
        "B4 FB2 FB4 SB4",
        "WR-004 ERR-006",
    ),
)
