"""What is measured: each probe is a function that makes one call and returns the nanoseconds that it took."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import paho.mqtt.client as paho
from asyncua import Client as OpcUaClient
from asyncua import ua
from paho.mqtt.enums import CallbackAPIVersion
from pymodbus.client import AsyncModbusTcpClient

from pytest_otmcp.plant import MockDevice

from .pipe_client import PipeClient

__all__ = ["NAMES", "Bench", "Probe", "bench"]

Probe = Callable[[], int]

NAMES = {
    "floor": "JSON line echo, no SDK",
    "null": "null tool, adapters' skeleton",
    "stock": "null tool, stock SDK server",
    "modbus": "raw: pymodbus, read 4 input registers",
    "mqtt": "raw: paho, publish QoS 0 until written",
    "mqtt_exchange": "raw: paho, publish QoS 1 until acknowledged",
    "opcua": "raw: asyncua, read one node",
    "M2": "adapter M2: read 4 input registers",
    "Q3": "adapter Q3: publish QoS 0",
    "O1": "adapter O1: read one node",
    "O4": "adapter O4: enumerate all variables",
}
"""The probes and what each of them does."""

_TEMPERATURE = "ns=2;s=Temperature"
_TOPIC, _PAYLOAD = "control/pump", '{"pump_speed": 50}'
_PATIENCE_S = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """Everything running.

    Attributes:
        probes: by the names of :data:`NAMES`.
        enumeration_services: the kinds of the service requests that the OPC UA device saw during one O4 call.
    """

    probes: dict[str, Probe]
    enumeration_services: list[str]


@contextmanager
def bench() -> Iterator[Bench]:
    """Start mock devices, servers and raw clients; end them all."""
    with ExitStack() as stack:
        # One loop for the raw clients; while a pipe is measured, nothing is due on it.
        runner = stack.enter_context(asyncio.Runner())
        modbus, mqtt, opcua = devices = [MockDevice(name) for name in ("modbus", "mqtt", "opcua")]
        for device in devices:
            stack.callback(_end, runner, device)
            runner.run(device.launch())

        def server(*arguments: str, **env: str) -> PipeClient:
            client = PipeClient(*arguments, env=env)
            stack.callback(client.close)
            return client

        adapters = "pytest_otmcp.reference_adapters"
        echo = server("benchmarks.echo_server")
        skeleton = server("benchmarks.null_adapter")
        stock = server("benchmarks.null_stock")
        m = server(adapters, "modbus", MODBUS_HOST=modbus.host, MODBUS_PORT=str(modbus.port))
        q = server(adapters, "mqtt", MQTT_URL=f"mqtt://{mqtt.host}:{mqtt.port}", MQTT_WRITES_ENABLED="true")
        o = server(adapters, "opcua", OPCUA_URL=f"opc.tcp://{opcua.host}:{opcua.port}")
        for client in (echo, skeleton, stock, m, q, o):
            client.discover()

        probes: dict[str, Probe] = {
            "floor": lambda: echo.call("null", {}),
            "null": lambda: skeleton.call("null", {}),
            "stock": lambda: stock.call("null", {}),
            "modbus": _modbus(stack, runner, modbus),
            "mqtt": _mqtt(stack, mqtt, qos=0),
            "mqtt_exchange": _mqtt(stack, mqtt, qos=1),
            "opcua": _opcua(stack, runner, opcua),
            "M2": lambda: m.call("read_input_registers", {"address": 0, "count": 4}),
            "Q3": lambda: q.call("publish_message", {"topic": _TOPIC, "payload": _PAYLOAD, "qos": 0}),
            "O1": lambda: o.call("read_opcua_node", {"node_id": _TEMPERATURE}),
            "O4": lambda: o.call("get_all_variables", {}),
        }
        for probe in probes.values():
            probe()
        # Counted on the connected session: connecting is not part of an enumeration.
        mark = runner.run(opcua.mark())
        probes["O4"]()
        entries = runner.run(opcua.journal(mark)).entries
        yield Bench(
            probes=probes,
            enumeration_services=[entry["kind"] for entry in entries if entry["direction"] == "in"],
        )


def _end(runner: asyncio.Runner, device: MockDevice) -> None:
    runner.run(device.close())


def _timed(runner: asyncio.Runner, request: Callable[[], Awaitable[object]]) -> Probe:
    async def once() -> int:
        started = time.perf_counter_ns()
        await request()
        return time.perf_counter_ns() - started

    # The clock runs inside the coroutine: entering and leaving the loop is not the protocol's cost.
    return lambda: runner.run(once())


def _modbus(stack: ExitStack, runner: asyncio.Runner, device: MockDevice) -> Probe:
    async def connected() -> AsyncModbusTcpClient:
        client = AsyncModbusTcpClient(device.host, port=device.port, retries=0, reconnect_delay=0)
        assert await client.connect()
        return client

    async def read() -> None:
        reply = await client.read_input_registers(0, count=4, device_id=1)
        assert not reply.isError()

    client = runner.run(connected())
    # Closing needs the running loop; the device's end, which comes later, runs it.
    stack.callback(lambda: runner.get_loop().call_soon(client.close))
    return _timed(runner, read)


def _mqtt(stack: ExitStack, device: MockDevice, *, qos: int) -> Probe:
    client = paho.Client(CallbackAPIVersion.VERSION2, client_id=f"benchmark-{qos}", protocol=paho.MQTTv5)
    acknowledged: set[int] = set()
    client.on_publish = lambda c, u, mid, reason, properties: acknowledged.add(mid)
    client.connect(device.host, device.port)
    stack.callback(client.disconnect)
    until = time.monotonic() + _PATIENCE_S
    while not client.is_connected() and time.monotonic() < until:
        client.loop(0.1)
    assert client.is_connected()

    def publish() -> int:
        acknowledged.clear()
        until = time.monotonic() + _PATIENCE_S
        # Without its thread paho writes within publish(), as it does in the adapter: no hand-over is measured.
        started = time.perf_counter_ns()
        message = client.publish(_TOPIC, _PAYLOAD, qos)
        while message.mid not in acknowledged and time.monotonic() < until:
            client.loop(1.0)
        took_ns = time.perf_counter_ns() - started
        assert message.mid in acknowledged
        return took_ns

    return publish


def _opcua(stack: ExitStack, runner: asyncio.Runner, device: MockDevice) -> Probe:
    client = OpcUaClient(f"opc.tcp://{device.host}:{device.port}")
    runner.run(client.connect())
    stack.callback(lambda: runner.run(client.disconnect()))
    parameters = ua.ReadParameters()
    node = ua.NodeId.from_string(_TEMPERATURE)
    parameters.NodesToRead = [ua.ReadValueId(NodeId=node, AttributeId=ua.AttributeIds.Value)]

    async def read() -> None:
        (result,) = await client.uaclient.read(parameters)
        assert result.StatusCode.is_good()

    return _timed(runner, read)
