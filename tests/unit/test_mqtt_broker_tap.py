"""A broker of the user's own behind the tap: it gives the same answers to the same questions as a mock."""

from __future__ import annotations

import asyncio
import base64
import socket
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import paho.mqtt.client as untyped_paho
import pytest

from pytest_otmcp.errors import KitError
from pytest_otmcp.plant.mock_device import MockDevice
from pytest_otmcp.plant.mqtt_broker import TappedBroker
from pytest_otmcp.protocols.mqtt import oracle as mqtt_oracle

from ..feeding import fed
from ..foreign_software.conftest import running_mosquitto

pytestmark = pytest.mark.asyncio

paho: Any = untyped_paho


@asynccontextmanager
async def the_mock() -> AsyncIterator[str]:
    device = MockDevice("mqtt")
    await device.launch()
    try:
        yield f"mqtt://{device.host}:{device.port}"
    finally:
        await device.close()


@asynccontextmanager
async def behind_a_tap(url: str) -> AsyncIterator[TappedBroker]:
    broker = TappedBroker(url)
    await broker.launch()
    try:
        yield broker
    finally:
        await broker.close()


@contextmanager
def client(port: int) -> Iterator[Any]:
    one = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id="adapter")
    one.reconnect_delay_set(0.05, 0.05)
    one.connect("127.0.0.1", port)
    one.loop_start()
    try:
        yield one
    finally:
        one.disconnect()
        one.loop_stop()


def message(text: bytes, **fields: Any) -> dict[str, Any]:
    return {"topic": "sensors/temperature", "payload": base64.b64encode(text).decode(), **fields}


async def exercise(url: str) -> None:
    async with behind_a_tap(url) as broker:
        with client(broker.port) as adapter:
            await broker.wait(0, {"kind": "CONNACK"}, timeout_s=60.0)
            mark = await broker.mark()
            adapter.subscribe("sensors/#", qos=1)
            await broker.wait(mark, {"kind": "SUBACK"}, timeout_s=60.0)
            for qos in (0, 1):
                await broker.poke(publish=message(b"nonce %d" % qos, qos=qos))
            delivered = {"kind": "PUBLISH", "direction": "out", "topic": "sensors/temperature"}
            assert len(await broker.wait(mark, delivered, timeout_s=60.0, count=2)) == 2
            adapter.publish("control/pump", b"50")
            await broker.wait(mark, {"kind": "PUBLISH", "topic": "control/pump"}, timeout_s=60.0)
            journal = (await broker.journal(mark)).entries
            assert fed(mqtt_oracle.Subscriptions(), journal).granted("sensors/#", qos=1) == []
            assert mqtt_oracle.delivered(journal, topic="sensors/temperature", payload=b"nonce 1") == []
            assert mqtt_oracle.published_once(journal, topic="control/pump", payload=b"50") == []
            assert mqtt_oracle.session_stays_up(journal) == []

            await broker.stop()
            assert not broker.running
            with pytest.raises(ConnectionRefusedError):
                await asyncio.open_connection(broker.host, broker.port)
            await broker.start()
            assert await broker.wait(0, {"kind": "CONNACK", "client_id": "adapter"}, timeout_s=60.0)
            assert (await broker.journal(0)).entries[0]["seq"] == 0


async def test_the_mock_serves_as_a_broker_of_the_users_own() -> None:
    async with the_mock() as url:
        await exercise(url)


@pytest.mark.long
async def test_mosquitto_serves_as_a_broker_of_the_users_own(tmp_path: Path) -> None:
    with running_mosquitto(tmp_path) as port:
        await exercise(f"mqtt://127.0.0.1:{port}")


async def test_the_kit_may_have_several_connections_to_one_broker() -> None:
    async with the_mock() as url:
        brokers = [TappedBroker(url) for _ in range(8)]
        await asyncio.gather(*(broker.launch() for broker in brokers))
        await asyncio.gather(*(broker.close() for broker in brokers))


async def test_a_broker_that_is_not_there_is_no_fault_of_the_adapter() -> None:
    # The port is bound and never listens: it refuses connections, and no other process can take it.
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        with pytest.raises(KitError, match=f"the broker mqtt://127.0.0.1:{port} cannot be used: the port refuses"):
            await TappedBroker(f"mqtt://127.0.0.1:{port}").launch()


async def test_a_service_that_is_no_broker_is_said_to_be_none() -> None:
    def greet(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"\0\0 220 mail ready\r\n")
        writer.close()

    server = await asyncio.start_server(greet, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    with pytest.raises(KitError, match="it does not speak MQTT: packet type 0 is reserved"):
        await TappedBroker(f"mqtt://127.0.0.1:{port}").launch()
    server.close()


async def test_a_foreign_broker_has_no_image() -> None:
    with pytest.raises(KitError, match="cannot be asked what it holds"):
        await TappedBroker("mqtt://127.0.0.1").image()
