"""Defects of a BACnet adapter."""

from __future__ import annotations

from typing import Any

from ..core import AdapterServer, Call
from .any_protocol import guard_after_sending
from .mutant import Data, Handler, Mutant, each, succeeding

__all__ = ["MUTANTS", "told_as_asked"]

_WRITE = "write_property"
_LOWEST = 16


def told_as_asked(call: Call, arguments: Any) -> Data:
    return {
        **arguments.model_dump(include={"device_id", "object_type", "object_instance", "property_id", "value"}),
        "present_value": arguments.value,
        "priority": arguments.priority,
        "winning_priority": arguments.priority,
    }


def at_the_lowest_priority(server: AdapterServer) -> None:
    def lowered(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data: Data = await genuine(call, arguments.model_copy(update={"priority": _LOWEST}))
            return data

        return handler

    each(_WRITE, change=lowered)(server)


MUTANTS = (
    Mutant(
        id="MU-02bac",
        protocol="bacnet",
        sentence="Every BACnet write goes to priority 16, whichever was asked for.",
        bend=at_the_lowest_priority,
        items="B3 B5 B6 FB5 SB2",
        requirements="WR-001 WR-002",
    ),
    Mutant(
        id="MU-14bac",
        protocol="bacnet",
        sentence="A BACnet write that the device acknowledges is told as done, although a higher priority wins.",
        bend=succeeding(_WRITE, code="verify_failed", answer=told_as_asked),
        items="B5",
        requirements="WR-001",
    ),
    Mutant(
        id="MU-20bac",
        protocol="bacnet",
        sentence="With writes disabled the WriteProperty is sent, and then denied.",
        bend=guard_after_sending(_WRITE),
        items="B4 FB2 FB4 SB4",
        requirements="WR-004 ERR-006",
    ),
)
