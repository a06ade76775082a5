"""The MQTT device: the embedded broker, and the simulated plant connected to it."""

from __future__ import annotations

import asyncio
import base64
import binascii
import socket
from collections.abc import Mapping
from typing import Any

from ..device import Device
from ..endpoint import OpenEndpoint
from .broker import Broker
from .connection import Connection
from .describe import describe_content, describe_publish
from .edge_node import EdgeNode
from .faults import FaultPlan
from .packets import Publish
from .topics import check_name
from .wire import ProtocolViolation

__all__ = ["MqttDevice"]

KIT = "otmcp-kit"


class MqttDevice(Device):
    """The broker device, for MQTT 3.1.1 and 5."""

    protocol = "mqtt"

    def __init__(self) -> None:
        super().__init__()
        self.broker = Broker(self.journal)
        self.edge_node = EdgeNode()
        self._servers: list[asyncio.Server] = []

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        listener = endpoints["mqtt"]
        assert isinstance(listener, socket.socket)
        loop = asyncio.get_running_loop()

        # The plant has a listener of its own and publishes its births before clients are accepted: what clients find
        # does not depend on who is faster, and they do not wait for the births.
        private = await loop.create_server(lambda: Connection(self.broker, origin="plant"), "127.0.0.1", 0)
        host, port = private.sockets[0].getsockname()
        await self.edge_node.start(host, port)
        public = await loop.create_server(lambda: Connection(self.broker), sock=listener, backlog=128)
        self._servers = [private, public]

    async def aclose(self) -> None:
        await self.edge_node.aclose()
        for server in self._servers:
            server.close()
        await self.broker.aclose()

    def image(self) -> dict[str, Any]:
        """Return the ``retained`` messages (topic to base64), the ``clients`` and their subscriptions, the
        ``edge_node``; and ``points``: ``retained/<topic>`` as base64, ``edge_node/<device>/<tag>`` as value."""
        retained = {
            topic: base64.b64encode(message.payload).decode() for topic, message in self.broker.retained.items()
        }
        return {
            "retained": retained,
            "clients": [
                {
                    "client_id": session.client_id,
                    "connection": session.connection,
                    "subscriptions": [{"filter": one.filter, "qos": one.qos} for one in session.subscriptions.values()],
                }
                for session in self.broker.sessions.values()
                if session.outlet is not None
            ],
            "edge_node": self.edge_node.image(),
            "points": {f"retained/{topic}": payload for topic, payload in retained.items()} | self.edge_node.points(),
        }

    async def poke(self, params: Mapping[str, Any]) -> None:
        """Publish a message of the kit; the journal has it as received on connection 0: ``{"publish": {"topic",
        "payload" (base64), "qos", "retain"}}``."""
        packet = _publish(params)
        content = describe_content(packet.topic, packet.payload)
        fields = describe_publish(packet, content)
        self.journal.append(connection=0, direction="in", kind="PUBLISH", origin="kit", client_id=KIT, **fields)
        self.broker.publish(packet, KIT, content)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.broker.faults = self.broker.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.broker.faults = FaultPlan([])
        self.broker.forget()
        await self.edge_node.reset()

    async def tick(self) -> None:
        await self.edge_node.tick()


def _publish(params: Mapping[str, Any]) -> Publish:
    source = params.get("publish")
    if not isinstance(source, Mapping) or not {"topic", "payload"} <= source.keys():
        raise ValueError("an MQTT poke is {'publish': {'topic': …, 'payload': base64, 'qos': 0, 'retain': false}}")
    qos = source.get("qos", 0)
    if qos not in (0, 1, 2):
        raise ValueError(f"qos: expected 0, 1 or 2, found {qos!r}")
    try:
        topic = str(source["topic"])
        check_name(topic)
        payload = base64.b64decode(source["payload"], validate=True)
    except (ProtocolViolation, binascii.Error) as error:
        raise ValueError(str(error)) from None
    return Publish(topic=topic, payload=payload, qos=qos, retain=bool(source.get("retain", False)))
