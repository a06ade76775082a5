"""Defects of a DNP3 adapter."""

from __future__ import annotations

from functools import partial
from typing import Any

from ..core import AdapterServer, Call
from .any_protocol import guard_after_sending
from .areas.further import module_of
from .defect import Data, Handler, around, defect, succeeding

__all__ = ["DEFECTS"]

_READ, _WRITE = "read_analog_inputs", "write_binary_output"


_module = partial(module_of, "dnp3")


@around(_READ)
async def index_from_1(genuine: Handler, call: Call, arguments: Any) -> Data:
    data = await genuine(call, arguments.model_copy(update={"start_index": arguments.start_index + 1}))
    return {**data, "points": [{**point, "index": point["index"] - 1} for point in data["points"]]}


@around(_WRITE)
async def neighbour_operated(genuine: Handler, call: Call, arguments: Any) -> Data:
    data = await genuine(call, arguments.model_copy(update={"index": arguments.index + 1}))
    return {**data, "index": arguments.index}


def without_select(server: AdapterServer) -> None:
    tools = _module("tools").Tools
    genuine = tools._operate

    async def directly(self: Any, call: Call, outstation: int, objects: bytes, *, direct: bool = False) -> int:
        status: int = await genuine(self, call, outstation, objects, direct=True)
        return status

    tools._operate = directly


def any_answer_is_success(server: AdapterServer) -> None:
    tools = _module("tools")
    tools.echoed_status = lambda objects, blocks: 0
    succeeding(_WRITE, code="verify_failed", answer=_told)(server)


def _told(call: Call, arguments: Any) -> Data:
    return {
        "outstation_address": arguments.outstation_address,
        "index": arguments.index,
        "value": arguments.value,
        "code": arguments.control,
        "mode": arguments.mode,
        "status": "SUCCESS",
        "state": arguments.value,
    }


def _no_points(call: Call, arguments: Any) -> Data:
    return {"outstation_address": arguments.outstation_address, "points": []}


def quality_dropped(server: AdapterServer) -> None:
    objects = _module("objects")
    objects.Point.is_reliable = property(lambda point: True)
    tools = _module("tools")
    shown = tools.shown
    tools.shown = lambda point: {**shown(point), "flags": None}


def nothing_confirmed(server: AdapterServer) -> None:
    _module("connection").Connection._confirm = lambda self, outstation, sequence, flags=0: None


def told_to_nobody(server: AdapterServer) -> None:
    _module("link").Link._keep = lambda self, outstation, points: True


DEFECTS = (
    defect(
        "MU-01dnp",
        "dnp3",
        "Analog inputs are counted from 1: each index is the one of the point before.",
        index_from_1,
        "D2 D7 FD1 FD5 SD1 SD3 SD4",
        "RD-001 RD-004",
    ),
    defect(
        "MU-02dnp",
        "dnp3",
        "The binary output beside the one that was asked for is operated, and told as the right one.",
        neighbour_operated,
        "D3 D4 D6 FD4 FD6",
        "ADR-001 ERR-002 WR-001 WR-002",
    ),
    defect("MU-07dnp", "dnp3", "Outputs are operated without being selected.", without_select, "D3 SD2", "WR-001"),
    defect(
        "MU-14dnp",
        "dnp3",
        "Every answer to a command is success: the status in the echo of its object is not looked at.",
        any_answer_is_success,
        "D6 FD2 FD3 FD6",
        "ENV-007 ERR-002 ERR-006 WR-001",
    ),
    defect(
        "MU-20dnp",
        "dnp3",
        "With writes disabled the output is operated, and then the command denied.",
        guard_after_sending(_WRITE),
        "D4",
        "WR-004",
    ),
    defect(
        "MU-46dnp",
        "dnp3",
        "A read that the outstation refuses is a success without points.",
        succeeding(_READ, code="illegal_address", answer=_no_points),
        "FD1",
        "ERR-002",
    ),
    defect(
        "MU-63dnp",
        "dnp3",
        "Events are not confirmed, so the outstation tells them again.",
        nothing_confirmed,
        "D5 D7",
        "RD-001",
    ),
    defect(
        "MU-81dnp",
        "dnp3",
        "The last value of a point that is off line is told as a good one, without its flags.",
        quality_dropped,
        "FD5",
        "RD-001",
    ),
    defect(
        "MU-123u",
        "dnp3",
        "What the outstation tells unasked is confirmed, and nobody is told of it.",
        told_to_nobody,
        "D7",
        "RD-001",
    ),
)
