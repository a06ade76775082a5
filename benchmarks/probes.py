"""The probes of the benchmarks: each is a function that makes one call and returns the nanoseconds that it took."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial

from pytest_otmcp.plant.mock_device import MockDevice

from .families import FAMILIES
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

        def where(key: str) -> dict[str, str]:
            # A line has one master, so each program gets a line of its own; the clients of a port share the device.
            if key not in devices or "serial" in _where(devices[key]):
                devices[key] = device = MockDevice(key)
                stack.callback(_end, runner, device)
                runner.run(device.launch())
            return _where(devices[key])

        def start(*arguments: str, env: Mapping[str, str] | None = None) -> PipeClient:
            client = PipeClient(*arguments, env=env)
            stack.callback(client.close)
            return client

        null, stock = start("benchmarks.null_adapter"), start("benchmarks.null_stock")
        floor = start("benchmarks.raw_client", "nothing")
        keys = [family.key for family in FAMILIES]
        raw = {key: start("benchmarks.raw_client", key, *where(key).values()) for key in keys}
        raw["mqtt_exchange"] = start("benchmarks.raw_client", "mqtt_exchange", *where("mqtt").values())
        control = {key: start("benchmarks.null_adapter", key, *where(key).values()) for key in keys}
        adapter = {
            family.key: start(
                "pytest_otmcp.reference_adapters",
                family.key,
                env={name: value.format(**where(family.key)) for name, value in family.env.items()},
            )
            for family in FAMILIES
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


def _where(device: MockDevice) -> dict[str, str]:
    (endpoint, *_) = device.endpoints.values()
    return {"serial": endpoint.path} if endpoint.kind == "pty" else {"host": endpoint.host, "port": str(endpoint.port)}


def _end(runner: asyncio.Runner, device: MockDevice) -> None:
    runner.run(device.close())
