"""What checks for every protocol do on OPC UA: a variable that is read, and one that is written."""

from __future__ import annotations

import random
from functools import partial

from ..exercise import Asked, Contended, Exercise, Limited, every_change
from ..journal import JournalEntry
from .entries import as_opcua

__all__ = ["EXERCISE"]

_READ, _WRITTEN = "Temperature", "ValvePosition"
_NODES = (_READ, "Pressure", "FlowRate", "TankLevel", "Vibration", "PhLevel", "Humidity", "MotorSpeed")


def _read(rng: random.Random) -> Asked:
    value = round(rng.uniform(-50.0, 150.0), 6)
    return Asked(
        operation="read",
        inputs={"node": f"ns=2;s={_READ}"},
        outputs={"value": value},
        pokes=({"node": _READ, "value": value},),
    )


def _write(rng: random.Random) -> Asked:
    value = round(rng.uniform(1.0, 99.0), 3)
    node = f"ns=2;s={_WRITTEN}"
    return Asked(
        operation="write", inputs={"node": node, "value": value}, outputs={"value": value}, points={node: value}
    )


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    values = {name: round(rng.uniform(-50.0, 150.0), 6) for name in _NODES}
    names = [_NODES[index % len(_NODES)] for index in range(count)]
    return tuple(
        Asked(
            operation="read",
            inputs={"node": f"ns=2;s={name}"},
            outputs={"value": values[name]},
            pokes=({"node": name, "value": values[name]},),
            condition={"node": f"ns=2;s={name}"},
        )
        for name in names
    )


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    value, other = (round(rng.uniform(1.0, 99.0), 3) for _ in range(2))
    valve, pump = f"ns=2;s={_WRITTEN}", "ns=2;s=PumpEnabled"
    off = ({"node": "PumpEnabled", "value": False},)
    return (
        Asked(operation="write", inputs={"node": valve, "value": value}, points={valve: value}),
        Asked(operation="write", inputs={"node": pump, "value": True}, pokes=off, points={pump: True}),
        Asked(
            operation="write_many",
            inputs={"items": [{"node_id": valve, "value": other}, {"node_id": pump, "value": True}]},
            pokes=off,
            points={valve: other, pump: True},
        ),
    )


def _contended(rng: random.Random) -> Contended:
    old, *new = (round(rng.uniform(1.0, 99.0), 6) for _ in range(3))
    node = "ns=2;s=FanSpeed"
    return Contended(
        old=old,
        new=tuple(new),
        pokes=({"node": "FanSpeed", "value": old},),
        read=Asked(operation="read", inputs={"node": node}),
        output="value",
        writes=tuple(
            Asked(operation="write", inputs={"node": node, "value": value}, points={node: value}) for value in new
        ),
    )


def _asks_for(entry: JournalEntry) -> object:
    nodes = as_opcua(entry)["nodes"]
    return nodes[0].get("value") if len(nodes) == 1 else None


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    valve, fan, pump = (f"ns=2;s={name}" for name in (_WRITTEN, "FanSpeed", "PumpEnabled"))
    number = round(rng.uniform(1.0, 99.0), 3)
    batches = ([(valve, number), (pump, True)], [(pump, True), (valve, number)], [(valve, number + 0.5)])
    return (
        Asked(operation="write", inputs={"node": valve, "value": number}, points={valve: number}),
        Asked(operation="write", inputs={"node": pump, "value": True}, points={pump: True}),
        Asked(operation="write", inputs={"node": fan, "value": number}, points={fan: number}),
        *(
            Asked(
                operation="write_many",
                inputs={"items": [{"node_id": node, "value": value} for node, value in items]},
                points=dict(items),
            )
            for items in batches
        ),
    )


def _one(node: str, value: float) -> Asked:
    return Asked(operation="write", inputs={"node": node, "value": value}, points={node: value})


def _in_a_batch(node: str, value: float) -> Asked:
    items = [{"node_id": node, "value": value}]
    return Asked(operation="write_many", inputs={"items": items}, points={node: value})


EXERCISE = Exercise(
    reading="read",
    read=_read,
    writing="write",
    write=_write,
    number="value",
    bounded=(),
    done=every_change,
    reads=({"service": "Read"}, {"service": "CreateMonitoredItems"}),
    writes=({"service": "Write"},),
    silent=tuple({"service": service, "action": {"drop": True}} for service in ("Read", "Write")),
    reset=tuple({"service": service, "action": {"reset": True}} for service in ("Read", "Write")),
    unauthorised=({"service": "ActivateSession", "action": {"service_fault": "BadIdentityTokenRejected"}},),
    refused=({"service": "Read", "action": {"status": "BadDeviceFailure"}},),
    distinct=_distinct,
    every_write=_every_write,
    contended=_contended,
    fenced=_fenced,
    limited={
        node: Limited(ways=(partial(_one, node), partial(_in_a_batch, node)), unit=0.5)
        for node in ("ns=2;s=HeaterPower", "ns=2;s=FanSpeed")
    },
    asks_for=_asks_for,
)
