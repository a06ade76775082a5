"""The probes of the benchmarks: each is a function that makes one call and returns the nanoseconds that it took."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial

from pytest_otmcp.plant.endpoint import Endpoint, endpoint_values
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.session.isolation import Isolation

from .families import FAMILIES, Family
from .pipe_client import PipeClient

__all__ = ["NAMES", "Bench", "Probe", "bench"]

Probe = Callable[[], int]

NAMES = {
    "floor": "a line and its answer, no SDK",
    "null": "null tool, adapters' skeleton",
    "stock": "null tool, stock SDK server",
    **{family.key: f"raw: {family.raw}" for family in FAMILIES},
    "mqtt_exchange": "raw: paho, publish QoS 1 until acknowledged",
    **{f"null+{family.key}": "control: null tool with the raw exchange in it" for family in FAMILIES},
    **{family.item: f"adapter {family.item}: {family.does}" for family in FAMILIES},
    "O4": "adapter O4: enumerate all variables",
}
"""The probes and what each of them does."""

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
        devices: dict[str, MockDevice] = {}
        # It makes the network of a cable.
        isolation = Isolation()
        stack.callback(isolation.close)

        def where(family: Family) -> Endpoint:
            # Each master gets a line of its own; the other clients of a protocol share the device.
            if family.key not in devices or family.alone:
                devices[family.key] = device = MockDevice(family.key)
                if family.cable:
                    device.walls = isolation.walls(cable=True)
                stack.callback(_end, runner, device)
                runner.run(device.launch())
            return _endpoint(devices[family.key])

        def start(*arguments: str) -> PipeClient:
            client = PipeClient(*arguments)
            stack.callback(client.close)
            return client

        def start_at(family: Family, *arguments: str, env: Mapping[str, str] | None = None) -> PipeClient:
            """Start a program with the words or the variables that say where the device is."""
            end = where(family)
            told = endpoint_values(family.key, {end.name: end})
            words = [] if env else [told[name] for name in family.told.split()]
            named = {name: value.format(**told) for name, value in (env or {}).items()}
            client = PipeClient(*arguments, *words, env=named, join=end.join)
            stack.callback(client.close)
            return client

        null, stock = start("benchmarks.null_adapter"), start("benchmarks.null_stock")
        floor = start("benchmarks.raw_client", "nothing")
        families = {family.key: family for family in FAMILIES}
        raw = {key: start_at(one, "benchmarks.raw_client", key) for key, one in families.items()}
        raw["mqtt_exchange"] = start_at(families["mqtt"], "benchmarks.raw_client", "mqtt_exchange")
        control = {key: start_at(one, "benchmarks.null_adapter", key) for key, one in families.items()}
        adapter = {
            key: start_at(one, "pytest_otmcp.reference_adapters", key, env=one.env) for key, one in families.items()
        }
        for client in (null, stock, floor, *raw.values(), *control.values(), *adapter.values()):
            client.discover()

        probes: dict[str, Probe] = {
            "floor": floor.exchange,
            "null": lambda: null.call("null", {}),
            "stock": lambda: stock.call("null", {}),
            **{name: client.exchange for name, client in raw.items()},
            **{f"null+{name}": partial(client.call, "null", {}) for name, client in control.items()},
            **{one.item: partial(adapter[one.key].call, one.tool, one.arguments) for one in FAMILIES},
            "O4": lambda: adapter["opcua"].call("get_all_variables", {}),
        }
        for probe in probes.values():
            for _ in range(_WARM_UP):
                probe()
        # The service calls are counted on the connected session: connecting is not part of an enumeration.
        mark = runner.run(devices["opcua"].mark())
        probes["O4"]()
        entries = runner.run(devices["opcua"].journal(mark)).entries
        yield Bench(
            probes=probes,
            enumeration_services=[entry["kind"] for entry in entries if entry["direction"] == "in"],
        )


def _endpoint(device: MockDevice) -> Endpoint:
    (endpoint, *_) = device.endpoints.values()
    return endpoint


def _end(runner: asyncio.Runner, device: MockDevice) -> None:
    runner.run(device.close())
