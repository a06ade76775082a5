"""The probes of the benchmarks: each is a function that makes one call and returns the nanoseconds that it took."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial

from pytest_otmcp.plant.mock_device import MockDevice

from .pipe_client import PipeClient
from .workload import INPUT_REGISTERS, PAYLOAD, TEMPERATURE, TOPIC

__all__ = ["NAMES", "Bench", "Probe", "bench"]

Probe = Callable[[], int]

NAMES = {
    "floor": "a line and its answer, no SDK",
    "null": "null tool, adapters' skeleton",
    "stock": "null tool, stock SDK server",
    "modbus": "raw: pymodbus, read 4 input registers",
    "mqtt": "raw: paho, publish QoS 0 until written",
    "mqtt_exchange": "raw: paho, publish QoS 1 until acknowledged",
    "opcua": "raw: asyncua, read one node",
    "null+modbus": "control: null tool with the raw exchange in it",
    "null+mqtt": "control: null tool with the raw exchange in it",
    "null+opcua": "control: null tool with the raw exchange in it",
    "M2": "adapter M2: read 4 input registers",
    "Q3": "adapter Q3: publish QoS 0",
    "O1": "adapter O1: read one node",
    "O4": "adapter O4: enumerate all variables",
}
"""The probes and what each of them does."""

_DEVICES = ("modbus", "mqtt", "opcua")
"""The devices; also the names of the raw exchanges that adapters are compared with and that have a control."""

_WARM_UP = 20
"""The calls of each probe before anything counts: connecting, lazy imports, specialised bytecode."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """Everything that runs for a measurement.

    Attributes:
        probes: the probes, by the names of :data:`NAMES`.
        enumeration_services: the kinds of the service requests that the OPC UA device saw during one O4 call.
    """

    probes: dict[str, Probe]
    enumeration_services: list[str]


@contextmanager
def bench() -> Iterator[Bench]:
    """Start mock devices, servers and raw clients; end them all."""
    with ExitStack() as stack:
        runner = stack.enter_context(asyncio.Runner())
        modbus, mqtt, opcua = devices = [MockDevice(name) for name in _DEVICES]
        for device in devices:
            stack.callback(_end, runner, device)
            runner.run(device.launch())

        def start(*arguments: str, **env: str) -> PipeClient:
            client = PipeClient(*arguments, env=env)
            stack.callback(client.close)
            return client

        null, stock = start("benchmarks.null_adapter"), start("benchmarks.null_stock")
        floor = start("benchmarks.raw_client", "nothing", "", "0")
        at = {name: (name, device.host, str(device.port)) for name, device in zip(_DEVICES, devices, strict=True)}
        raw = {name: start("benchmarks.raw_client", *where) for name, where in at.items()}
        raw["mqtt_exchange"] = start("benchmarks.raw_client", "mqtt_exchange", mqtt.host, str(mqtt.port))
        control = {name: start("benchmarks.null_adapter", *where) for name, where in at.items()}
        adapters = "pytest_otmcp.reference_adapters"
        m = start(adapters, "modbus", MODBUS_HOST=modbus.host, MODBUS_PORT=str(modbus.port))
        q = start(adapters, "mqtt", MQTT_URL=f"mqtt://{mqtt.host}:{mqtt.port}", MQTT_WRITES_ENABLED="true")
        o = start(adapters, "opcua", OPCUA_URL=f"opc.tcp://{opcua.host}:{opcua.port}")
        for client in (null, stock, floor, *raw.values(), *control.values(), m, q, o):
            client.discover()

        probes: dict[str, Probe] = {
            "floor": floor.exchange,
            "null": lambda: null.call("null", {}),
            "stock": lambda: stock.call("null", {}),
            **{name: client.exchange for name, client in raw.items()},
            **{f"null+{name}": partial(client.call, "null", {}) for name, client in control.items()},
            "M2": lambda: m.call("read_input_registers", {"address": 0, "count": INPUT_REGISTERS}),
            "Q3": lambda: q.call("publish_message", {"topic": TOPIC, "payload": PAYLOAD, "qos": 0}),
            "O1": lambda: o.call("read_opcua_node", {"node_id": TEMPERATURE}),
            "O4": lambda: o.call("get_all_variables", {}),
        }
        for probe in probes.values():
            for _ in range(_WARM_UP):
                probe()
        # The service calls are counted on the connected session: connecting is not part of an enumeration.
        mark = runner.run(opcua.mark())
        probes["O4"]()
        entries = runner.run(opcua.journal(mark)).entries
        yield Bench(
            probes=probes,
            enumeration_services=[entry["kind"] for entry in entries if entry["direction"] == "in"],
        )


def _end(runner: asyncio.Runner, device: MockDevice) -> None:
    runner.run(device.close())
