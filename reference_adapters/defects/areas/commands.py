"""Defects of adapters with vocabularies of their own, which the checks of the area WR notice by the effect of named commands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ...core import AdapterError, AdapterServer, Call
from ...modbus.shapes import WriteCoil, WriteRegister
from ..any_protocol import guard_after_sending
from ..defect import Change, Data, Defect, Handler, around, defect, tools_of
from .err import retries_when_back
from .wr import sent_again

__all__ = ["DEFECTS", "asked_otherwise", "other"]

_SPEED, _VALVE, _START = "set_pump_speed", "move_valve", "press_start"
_DIM, _SWITCH, _BELL = "set_brightness", "switch_light", "ring_bell"
_BATCH, _ALL = "start_batch", "switch_all"


def nothing_sent(*names: str, answer: Callable[[Any], Data]) -> Change:
    """Return the defect that these tools say that they have done it, and send nothing."""

    @around(*names)
    async def instead(genuine: Handler, call: Call, arguments: Any) -> Data:
        return answer(arguments)

    return instead


def asked_otherwise(name: str, **changes: Callable[[Any], Any]) -> Change:
    """Return the defect that a tool takes other values for these arguments than it is given."""

    @around(name)
    async def bent(genuine: Handler, call: Call, arguments: Any) -> Data:
        update = {argument: change(getattr(arguments, argument)) for argument, change in changes.items()}
        data = await genuine(call, arguments.model_copy(update=update))
        return data

    return bent


def carried_out_twice(*names: str) -> Change:
    """Return the defect that these tools send everything twice."""

    @around(*names)
    async def twice(genuine: Handler, call: Call, arguments: Any) -> Data:
        await genuine(call, arguments)
        data = await genuine(call, arguments)
        return data

    return twice


def batch_by(*requests: str) -> Change:
    """Return the defect that a batch consists of these requests, ``litres`` and ``start``."""

    def apply(server: AdapterServer) -> None:
        tools = tools_of(server, _BATCH)._tools

        @around(_BATCH)
        async def instead(genuine: Handler, call: Call, arguments: Any) -> Data:
            for request in requests:
                if request == "litres":
                    await tools.write_register(call, WriteRegister(address=41, value=arguments.litres))
                else:
                    await tools.write_coil(call, WriteCoil(address=12, value=True))
            return {"done": "a batch has begun"}

        instead(server)

    return apply


def begun_regardless(server: AdapterServer) -> None:
    """The defect that a batch is said to have begun, whatever the device answered."""

    @around(_BATCH)
    async def instead(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            done: Data = await genuine(call, arguments)
        except AdapterError as error:
            if error.code != "device_failure":
                raise
            return {"done": f"a batch of {arguments.litres} litres has begun"}
        return done

    instead(server)


def the_same_is_spared(server: AdapterServer) -> None:
    """The defect that a speed which equals the one before is told as set, and not written."""
    last: list[object] = []

    @around(_SPEED)
    async def instead(genuine: Handler, call: Call, arguments: Any) -> Data:
        if last == [arguments.percent]:
            return {"done": f"the pump runs at {arguments.percent:g} %"}
        data = await genuine(call, arguments)
        last[:] = [arguments.percent]
        return data

    instead(server)


def kitchen_alone(server: AdapterServer) -> None:
    tools = tools_of(server, _ALL)

    @around(_ALL)
    async def instead(genuine: Handler, call: Call, arguments: Any) -> Data:
        sent: Data = await tools._light(call, "kitchen", state=arguments.state.upper())
        return sent

    instead(server)


def denied_after_sending(*names: str) -> Change:
    """Return the defect that with writes disabled these tools do what they are asked for, and then deny it."""

    def apply(server: AdapterServer) -> None:
        if not server.writes_enabled:
            for name in names:
                guard_after_sending(name)(server)

    return apply


def other(one: str, another: str) -> Callable[[Any], Any]:
    """Return what makes each of two values the other one."""
    return {one: another, another: one}.__getitem__


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-02n",
        "modbus",
        "The valves are mixed up.",
        asked_otherwise(_VALVE, valve=other("inlet", "outlet")),
        "WR-001 WR-002 WR-004 WR-014",
        "WR-001 WR-002 WR-014",
        named=True,
    ),
    defect(
        "MU-02nq",
        "mqtt",
        "The lights are mixed up when one is dimmed.",
        asked_otherwise(_DIM, light=other("kitchen", "hall")),
        "WR-003 WR-004 WR-005 WR-010 WR-014",
        "WR-001 WR-014",
        named=True,
    ),
    defect(
        "MU-121n",
        "modbus",
        "The percentage of the speed is taken for a tenth of it.",
        asked_otherwise(_SPEED, percent=lambda percent: percent / 10),
        "WR-001 WR-002 WR-003 WR-004 WR-005 WR-009 WR-010 WR-014",
        "WR-001 WR-014",
        named=True,
    ),
    defect(
        "MU-121nq",
        "mqtt",
        "A light is one step darker than it was asked for.",
        asked_otherwise(_DIM, level=lambda level: max(0, level - 1)),
        "WR-003 WR-004 WR-005 WR-010 WR-014",
        "WR-001 WR-014",
        named=True,
    ),
    defect(
        "MU-14n",
        "modbus",
        "The start button is told as pressed, and nothing is sent.",
        nothing_sent(_START, answer=lambda arguments: {"done": "the start button was pressed"}),
        "WR-001 WR-004 WR-009 WR-010 WR-014",
        "WR-001 WR-009 WR-014",
        named=True,
    ),
    defect(
        "MU-14nq",
        "mqtt",
        "A light is told as switched, and nothing is sent.",
        nothing_sent(_SWITCH, answer=lambda arguments: {"delivery": "acknowledged"}),
        "WR-004 WR-010 WR-014",
        "MQT-001 WR-001 WR-014",
        named=True,
    ),
    defect(
        "MU-02ns",
        "modbus",
        "A batch is started before it is said how much it is to be.",
        batch_by("start", "litres"),
        "WR-004 WR-014",
        "WR-001 WR-014",
        named=True,
    ),
    defect(
        "MU-14ns",
        "modbus",
        "It is said how much a batch is to be, and the batch is not started.",
        batch_by("litres"),
        "WR-004 WR-014",
        "WR-001 WR-014",
        named=True,
    ),
    defect(
        "MU-14nsq",
        "mqtt",
        "Of all lights that are switched the first one is.",
        kitchen_alone,
        "WR-004 WR-014",
        "WR-001 WR-014",
        named=True,
    ),
    defect(
        "MU-25ns",
        "modbus",
        "A batch is started twice by each call.",
        batch_by("litres", "start", "start"),
        "WR-004 WR-014",
        "WR-003 WR-014",
        named=True,
    ),
    defect(
        "MU-14nz",
        "modbus",
        "A speed that equals the one before is told as set, and not written.",
        the_same_is_spared,
        "WR-010 WR-014",
        "WR-001 WR-014",
        named=True,
    ),
    defect(
        "MU-16ns",
        "modbus",
        "A batch that the device has refused is said to have begun.",
        begun_regardless,
        "WR-014",
        named=True,
    ),
    defect(
        "MU-20ns",
        "modbus",
        "With writes disabled it is said how much a batch is to be, and then it is denied.",
        denied_after_sending(_BATCH),
        "WR-004",
        named=True,
    ),
    defect(
        "MU-20n",
        "modbus",
        "With writes disabled the start button is pressed, and then it is denied.",
        denied_after_sending(_START),
        "WR-004",
        named=True,
    ),
    defect(
        "MU-20nq",
        "mqtt",
        "With writes disabled the bell rings, and then it is denied.",
        denied_after_sending(_BELL),
        "WR-004",
        named=True,
    ),
    defect(
        "MU-25n",
        "modbus",
        "A speed whose confirmation is lost is sent again.",
        sent_again("timeout", "connection_lost", names=(_SPEED,)),
        "WR-003",
        named=True,
    ),
    defect(
        "MU-25nq",
        "mqtt",
        "A brightness whose acknowledgement is lost is sent again as a new message.",
        sent_again("timeout", "connection_lost", names=(_DIM,)),
        "WR-003",
        named=True,
    ),
    defect(
        "MU-25nt",
        "modbus",
        "A valve is moved twice by each call.",
        carried_out_twice(_VALVE),
        "WR-001 WR-002 WR-004 WR-014",
        "WR-003 WR-014",
        named=True,
    ),
    defect(
        "MU-29n",
        "modbus",
        "A valve that could not be moved is moved after the outage.",
        retries_when_back(_VALVE),
        "WR-010",
        named=True,
    ),
    defect(
        "MU-29nq",
        "mqtt",
        "A bell that could not be rung rings after the outage.",
        retries_when_back(_BELL),
        "WR-010",
        named=True,
    ),
)
