"""What checks for every protocol do on OPC UA: a variable that is read, and one that is written."""

from __future__ import annotations

import random
import zlib
from collections.abc import Callable, Mapping
from typing import Any

from ...core.strict_json import same_json
from ..exercise import Asked, Contended, DeviceText, Exercise, Limited, Poke, every_change, number_in_json
from ..journal import JournalEntry
from ..oracle import has
from ..point import BOOL, FLOAT64, Point
from ..proof import Call
from .entries import as_opcua, statuses

__all__ = ["EXERCISE", "PLACES"]

_READ, _WRITTEN = "Temperature", "ValvePosition"
_NODES = (_READ, "Pressure", "FlowRate", "TankLevel", "Vibration", "PhLevel", "Humidity", "MotorSpeed")
_ACTUATORS = (_WRITTEN, "HeaterPower", "FanSpeed", "ConveyorSpeed", "PumpEnabled", "AlarmActive")


def _node(name: str) -> Point:
    """Return the value of a variable."""
    node = f"ns=2;s={name}"
    return Point(
        kind=BOOL if name in ("PumpEnabled", "AlarmActive") else FLOAT64,
        reading=Call("read", {"node": node}),
        writing=Call("write", {"node": node}),
        pokes=lambda value: ({"node": name, "value": number_in_json(value) if isinstance(value, float) else value},),
        unsound=lambda value: ({"node": name, "value": value, "status": "BadSensorFailure"},),
        held=lambda value: {node: value},
        found=lambda image: image["points"][node],
        condition={"node": node},
    )


def _place(inputs: Mapping[str, Any]) -> Point | None:
    known = {f"ns=2;s={name}": name for name in (*_NODES, *_ACTUATORS)}
    name = known.get(str(inputs["node"]))
    return None if name is None else _node(name)


PLACES = {"read": _place}
"""The places of the mock OPC UA server that named readings may be of: its sensors and actuators."""


_VALVE, _FAN, _HEATER, _PUMP = map(_node, (_WRITTEN, "FanSpeed", "HeaterPower", "PumpEnabled"))


def _percent(rng: random.Random, digits: int = 3) -> float:
    return round(rng.uniform(1.0, 99.0), digits)


def _any(rng: random.Random) -> float:
    return round(rng.uniform(-50.0, 150.0), 6)


def _batch(*writes: Asked, pokes: tuple[Mapping[str, object], ...] = ()) -> Asked:
    """Return one call for several writes."""
    items = [{"node_id": one.inputs["node"], "value": one.inputs["value"]} for one in writes]
    points = {node: value for one in writes for node, value in one.points.items()}
    return Asked(operation="write_many", inputs={"items": items}, pokes=pokes, points=points)


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    known = [_node(name).read(_any(rng)) for name in _NODES]
    return tuple(known[index % len(known)] for index in range(count))


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    value, other = _percent(rng), _percent(rng)
    pump = _PUMP.write(True, before=False)
    return _VALVE.write(value), pump, _batch(_VALVE.write(other), pump, pokes=pump.pokes)


def _contended(rng: random.Random) -> Contended:
    return _FAN.contended(*(_percent(rng, 6) for _ in range(3)))


def _asks_for(entry: JournalEntry) -> object:
    nodes = as_opcua(entry)["nodes"]
    return nodes[0].get("value") if len(nodes) == 1 else None


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    number = _percent(rng)
    valve, pump = _VALVE.write(number), _PUMP.write(True)
    batches = _batch(valve, pump), _batch(pump, valve), _batch(_VALVE.write(number + 0.5))
    return valve, pump, _FAN.write(number), *batches


def _limits(point: Point) -> Limited:
    return Limited(ways=(point.write, lambda value: _batch(point.write(value))), unit=0.5)


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


def _held_otherwise(point: str, value: object) -> Poke:
    other = not value if isinstance(value, bool) else value - 1 if isinstance(value, int | float) else f"not {value}"
    return {"node": point.removeprefix("ns=2;s="), "value": other}


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


def _refusals(entry: JournalEntry) -> list[str]:
    return statuses(entry) if entry.get("direction") == "out" else []


EXERCISE = Exercise(
    points_of=_points_of,
    held=_held_otherwise,
    recognised={"write": _is_asked_for},
    changing=tuple({"service": service} for service in ("Write", "Call")),
    reading="read",
    read=lambda rng: _node(_READ).read(_any(rng)),
    writing="write",
    write=lambda rng: _VALVE.write(_percent(rng)),
    number="value",
    bounded=(),
    done=every_change,
    reads=({"service": "Read"}, {"service": "CreateMonitoredItems"}),
    writes=({"service": "Write"},),
    silent=tuple({"service": service, "action": {"drop": True}} for service in ("Read", "Write")),
    reset=tuple({"service": service, "action": {"reset": True}} for service in ("Read", "Write")),
    unauthorised=({"service": "ActivateSession", "action": {"service_fault": "BadIdentityTokenRejected"}},),
    refused=({"service": "Read", "action": {"status": "BadDeviceFailure"}},),
    refusals=_refusals,
    distinct=_distinct,
    every_write=_every_write,
    contended=_contended,
    fenced=_fenced,
    limited={
        "ns=2;s=HeaterPower": _limits(_HEATER),
        "ns=2;s=FanSpeed": _limits(_FAN),
    },
    asks_for=_asks_for,
    device_texts=_device_texts,
)
