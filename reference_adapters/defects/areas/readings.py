"""Defects of adapters with vocabularies of their own, which the checks of the area RD notice by what the device holds at a reading's source."""

from __future__ import annotations

from typing import Any

from ...core import AdapterError, AdapterServer, Call
from ..defect import Change, Data, Defect, Handler, around, defect, told
from .commands import asked_otherwise, other

__all__ = ["DEFECTS"]

_TEMPERATURE, _POSITION = "read_temperature", "valve_position"


def the_last_one_when_refused(server: AdapterServer) -> None:
    """The defect that a temperature which the device refuses to tell is told as it was before."""
    known: dict[str, Data] = {}

    @around(_TEMPERATURE)
    async def instead(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            known[arguments.place] = await genuine(call, arguments)
        except AdapterError as error:
            if error.code != "device_failure" or arguments.place not in known:
                raise
        return known[arguments.place]

    instead(server)


def _changed(change: Any) -> Change:
    return told(_TEMPERATURE, change=lambda data: {**data, "celsius": change(data["celsius"])})


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-02nr",
        "modbus",
        "The temperatures of inlet and outlet are mixed up.",
        asked_otherwise(_TEMPERATURE, place=other("inlet", "outlet")),
        "RD-004 RD-005 RD-008",
        "RD-001 RD-004 RD-008",
        named=True,
    ),
    defect(
        "MU-02np",
        "modbus",
        "A closed valve is told as open, and an open one as closed.",
        told(_POSITION, change=lambda data: {**data, "position": other("open", "closed")(data["position"])}),
        "RD-008",
        named=True,
    ),
    defect(
        "MU-04nr",
        "modbus",
        "Temperatures are told a tenth of a degree too high.",
        _changed(lambda celsius: round(celsius + 0.1, 1)),
        "RD-004 RD-005 RD-008",
        "RD-001 RD-004 RD-008",
        named=True,
    ),
    defect(
        "MU-07nr",
        "modbus",
        "Temperatures above 3276.7 degrees are told as below zero.",
        _changed(lambda celsius: celsius if celsius < 3276.8 else round(celsius - 6553.6, 1)),
        "RD-004 RD-008",
        "RD-001 RD-008",
        named=True,
    ),
    defect(
        "MU-16nr",
        "modbus",
        "A temperature that the device refuses to tell is told as it was before.",
        the_last_one_when_refused,
        "RD-008",
        named=True,
    ),
)
