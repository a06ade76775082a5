"""What checks for every protocol do on OPC UA: a variable that is read, and one that is written."""

from __future__ import annotations

import random
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from ...core.strict_json import same_json
from ..exercise import Asked, Contended, DeviceText, Exercise, Limited, every_change
from ..journal import JournalEntry
from ..oracle import has
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


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    def named(text: str) -> str:
        return f"{name}.{zlib.crc32(text.encode()):08x}"

    def held(text: str) -> dict[str, object]:
        return {"create": [{"variable": named(text), "type": "String", "value": text}]}

    def value(text: str) -> Asked:
        return Asked(operation="read", inputs={"node": f"ns=2;s={named(text)}"}, pokes=(held(text),))

    def several(text: str) -> Asked:
        node = {"variable": named(f"several/{text}"), "type": "String", "value": text}
        inputs = {"nodes": [f"ns=2;s={node['variable']}"]}
        return Asked(operation="read_many", inputs=inputs, pokes=({"create": [node]},))

    def shown(member: str, prefix: str = "") -> Callable[[str], Asked]:
        def browsed(text: str) -> Asked:
            folder = named(f"{member}/{text}")
            node = {"variable": f"{folder}.node", "in": folder, "type": "Int32", "value": 1, member: prefix + text}
            pokes = ({"create": [{"folder": folder}, node]},)
            return Asked(operation="browse", inputs={"node": f"ns=2;s={folder}"}, pokes=pokes)

        return browsed

    def enumerated(text: str) -> Asked:
        node = {"variable": named(f"all/{text}"), "type": "Int32", "value": 1, "browse_name": f"2:{text}"}
        return Asked(operation="variables", inputs={}, pokes=({"create": [{**node, "display_name": text}]},))

    def answered(text: str) -> Asked:
        method = named(f"method/{text}")
        return Asked(
            operation="call_method",
            inputs={"object": "ns=2;s=Methods", "method": f"ns=2;s={method}", "arguments": []},
            pokes=({"create": [{"method": method, "inputs": [], "returns": text}]},),
        )

    return (
        DeviceText(place="the value of a variable", ask=value, longest=10_000),
        DeviceText(place="the value of one of several variables", ask=several, longest=10_000),
        DeviceText(place="a browse name", ask=shown("browse_name", "2:"), longest=500),
        DeviceText(place="a display name", ask=shown("display_name"), longest=10_000),
        DeviceText(place="a description", ask=shown("description"), longest=10_000),
        DeviceText(place="a name in the list of all variables", ask=enumerated, longest=500),
        DeviceText(place="the result of a method", ask=answered, longest=10_000),
    )


def _points_of(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    if operation == "write":
        return {inputs["node"]: inputs["value"]}
    items = inputs["items"] if operation == "write_many" else ()
    return {item["node_id"]: item["value"] for item in items}


def _is_asked_for(entry: JournalEntry, asked: Asked) -> bool:
    nodes = as_opcua(entry).get("nodes", []) if entry["kind"] == "Write" else []
    return (
        len(nodes) == 1
        and has(nodes[0], node_id=asked.inputs["node"])
        and same_json(nodes[0].get("value"), asked.inputs["value"])
    )


EXERCISE = Exercise(
    points_of=_points_of,
    recognised={"write": _is_asked_for},
    changing=tuple({"service": service} for service in ("Write", "Call")),
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
    device_texts=_device_texts,
)
