"""Defects of a DNP3 adapter."""

from __future__ import annotations

from functools import partial
from typing import Any

from ..core import AdapterServer, Call
from .any_protocol import guard_after_sending
from .areas.further import module_of
from .mutant import Data, Handler, Mutant, each, succeeding

__all__ = ["MUTANTS"]

_READ, _WRITE = "read_analog_inputs", "write_binary_output"


_module = partial(module_of, "dnp3")


def index_from_1(server: AdapterServer) -> None:
    def shifted(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data: Data = await genuine(call, arguments.model_copy(update={"start_index": arguments.start_index + 1}))
            return {**data, "points": [{**point, "index": point["index"] - 1} for point in data["points"]]}

        return handler

    each(_READ, change=shifted)(server)


def neighbour_operated(server: AdapterServer) -> None:
    def shifted(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data: Data = await genuine(call, arguments.model_copy(update={"index": arguments.index + 1}))
            return {**data, "index": arguments.index}

        return handler

    each(_WRITE, change=shifted)(server)


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


MUTANTS = (
    Mutant(
        id="MU-01dnp",
        protocol="dnp3",
        sentence="Analog inputs are counted from 1: each index is the one of the point before.",
        bend=index_from_1,
        items="D2 D7 FD1 FD5 SD1 SD3 SD4",
        requirements="RD-001 RD-004",
    ),
    Mutant(
        id="MU-02dnp",
        protocol="dnp3",
        sentence="The binary output beside the one that was asked for is operated, and told as the right one.",
        bend=neighbour_operated,
        items="D3 D4 D6 FD4 FD6",
        requirements="ADR-001 ERR-002 WR-001 WR-002",
    ),
    Mutant(
        id="MU-07dnp",
        protocol="dnp3",
        sentence="Outputs are operated without being selected.",
        bend=without_select,
        items="D3 SD2",
        requirements="WR-001",
    ),
    Mutant(
        id="MU-14dnp",
        protocol="dnp3",
        sentence="Every answer to a command is success: the status in the echo of its object is not looked at.",
        bend=any_answer_is_success,
        items="D6 FD2 FD3 FD6",
        requirements="ENV-007 ERR-002 ERR-006 WR-001",
    ),
    Mutant(
        id="MU-20dnp",
        protocol="dnp3",
        sentence="With writes disabled the output is operated, and then the command denied.",
        bend=guard_after_sending(_WRITE),
        items="D4",
        requirements="WR-004",
    ),
    Mutant(
        id="MU-46dnp",
        protocol="dnp3",
        sentence="A read that the outstation refuses is a success without points.",
        bend=succeeding(_READ, code="illegal_address", answer=_no_points),
        items="FD1",
        requirements="ERR-002",
    ),
    Mutant(
        id="MU-63dnp",
        protocol="dnp3",
        sentence="Events are not confirmed, so the outstation tells them again.",
        bend=nothing_confirmed,
        items="D5 D7",
        requirements="RD-001",
    ),
    Mutant(
        id="MU-81dnp",
        protocol="dnp3",
        sentence="The last value of a point that is off line is told as a good one, without its flags.",
        bend=quality_dropped,
        items="FD5",
        requirements="RD-001",
    ),
    Mutant(
        id="MU-123u",
        protocol="dnp3",
        sentence="What the outstation tells unasked is confirmed, and nobody is told of it.",
        bend=told_to_nobody,
        items="D7",
        requirements="RD-001",
    ),
)
