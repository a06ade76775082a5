"""The MQTT device: the embedded broker and the simulated plant that is connected to it."""

from __future__ import annotations

import asyncio
import base64
import socket
from collections.abc import Mapping
from typing import Any

from ..device import Device
from .broker import Broker
from .codec import Kind, Packet
from .connection import Connection, journal_fields
from .edge_node import EdgeNode
from .faults import FaultPlan
from .session import Message
from .topics import valid_name

__all__ = ["MqttDevice"]


class MqttDevice(Device):
    """Serves MQTT 3.1.1 and 5.0."""

    protocol = "mqtt"

    def __init__(self) -> None:
        super().__init__()
        self.broker = Broker(self.journal)
        self.edge_node = EdgeNode()
        self._server: asyncio.Server | None = None

    async def serve(self, listener: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: Connection(self.broker), sock=listener, backlog=128)
        host, port = listener.getsockname()[:2]
        await self.edge_node.start(host, port)

    async def aclose(self) -> None:
        self.edge_node.close()
        if self._server is not None:
            self._server.close()

    def image(self) -> dict[str, Any]:
        return {
            "retained": {
                topic: base64.b64encode(message.payload).decode() for topic, message in self.broker.retained.items()
            },
            "clients": [
                {
                    "client_id": session.client_id,
                    "connection": session.connection.number,
                    "subscriptions": [
                        {"filter": text, "qos": subscription.qos}
                        for text, subscription in session.subscriptions.items()
                    ],
                }
                for session in self.broker.sessions.values()
                if session.connection is not None
            ],
            "edge_node": self.edge_node.image(),
        }

    async def poke(self, params: Mapping[str, Any]) -> None:
        """``{"publish": {"topic", "payload" (base64), "qos", "retain"}}``: a message from no client, on the journal as
        connection 0."""
        source = dict(params["publish"])
        fields = {
            "topic": str(source["topic"]),
            "payload": base64.b64decode(source["payload"]),
            "qos": int(source.get("qos", 0)),
            "retain": bool(source.get("retain", False)),
        }
        if not valid_name(fields["topic"]):
            raise ValueError(f"{fields['topic']!r} is no topic name")
        packet = Packet(Kind.PUBLISH, {**fields, "dup": False, "packet_id": None})
        self.journal.append(
            connection=0, direction="in", kind="PUBLISH", client_id="otmcp-kit", **journal_fields(packet)
        )
        self.broker.route(Message(**fields), None)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.broker.faults = self.broker.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.broker.faults = FaultPlan([])
        self.broker.retained = {
            topic: message for topic, message in self.broker.retained.items() if topic == "system/status"
        }

    async def tick(self) -> None:
        self.edge_node.tick()
