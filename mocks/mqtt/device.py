"""The MQTT device: the embedded broker, and the simulated plant connected to it."""

from __future__ import annotations

import asyncio
import base64
import socket
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pytest_otmcp.wire.mqtt.packets import Publish
from pytest_otmcp.wire.mqtt.sparkplug import message_fields
from pytest_otmcp.wire.mqtt.topics import matches

from ..accounts import Accounts
from ..device import Device
from ..endpoint import OpenEndpoint
from ..network import Network
from .broker import KIT, Broker
from .connection import Connection
from .edge_node import EdgeNode
from .faults import FaultPlan
from .pokes import BURST_TURN, Burst, command, disconnection, message

__all__ = ["MqttDevice"]

_ANSWERING_S = 0.1
"""Seconds after a SUBACK: a client that is still busy with the SUBACK itself has not lost the message yet."""


class MqttDevice(Device):
    """The broker device, for MQTT 3.1.1 and 5."""

    protocol = "mqtt"

    def __init__(self) -> None:
        super().__init__()
        self.broker = Broker(self.journal)
        self.edge_node = EdgeNode()
        self.network = Network(self.journal)
        # What happens to the clients' network does not happen to the plant's.
        self._private = Network(self.journal, self.network.numbers)
        self._server: asyncio.Server | None = None
        self._answering: list[Publish] = []
        self.broker.subscribed = self._subscribed

    @property
    def dead_connections(self) -> int:
        return self.network.dead

    async def serve(self, endpoints: Mapping[str, OpenEndpoint]) -> None:
        listener = endpoints["mqtt"]
        assert isinstance(listener, socket.socket)
        # The plant publishes its births before clients are accepted: what clients find does not depend on who is faster,
        # and they do not wait for the births.
        await self.edge_node.start(self._dial)
        self._server = await asyncio.get_running_loop().create_server(
            self.network.protocol(lambda: Connection(self.broker)), sock=listener, backlog=128
        )

    async def _dial(self) -> socket.socket:
        """Connect the plant with the broker. A port would be a door by which an adapter is taken for the plant."""
        plant, broker = socket.socketpair()
        served = self._private.protocol(lambda: Connection(self.broker, origin="plant"))
        await asyncio.get_running_loop().connect_accepted_socket(served, broker)
        return plant

    def secure(self, folder: Path) -> None:
        self.network.secure(folder)
        self.broker.accounts = Accounts(self.journal, folder)

    async def aclose(self) -> None:
        await self.edge_node.aclose()
        if self._server is not None:
            self._server.close()
        await self.broker.aclose()
        self.network.close()

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
        """Do something past the clients: see :mod:`.pokes`, :mod:`.edge_node_pokes` and :mod:`..network`."""
        if self.network.poke(params):
            return
        if len(params) > 1:
            raise ValueError(f"an MQTT poke has one member, found {sorted(params)}")
        if "burst" in params:
            await self._burst(Burst.of(params["burst"]))
        elif "answering" in params:
            self._answering.append(message(params["answering"]))
        elif "command" in params:
            self._publish(command(params["command"]))
        elif "disconnect" in params:
            client_id, code = disconnection(params["disconnect"])
            self.broker.disconnect(client_id, code)
        elif "account" in params:
            self.broker.accounts.become(params["account"])
            self.network.close()
        elif "edge_node" in params:
            await self.edge_node.poke(params["edge_node"])
        else:
            self._publish(message(params.get("publish")))

    def _subscribed(self, topic_filter: str) -> None:
        levels = topic_filter.split("/")
        for packet in self._answering:
            if matches(levels, packet.topic.split("/")):
                asyncio.get_running_loop().call_later(_ANSWERING_S, self._publish, packet)

    def _publish(self, packet: Publish) -> None:
        """Publish a message of the kit; the journal has it as received on connection 0."""
        if self.broker.counted is None:
            self.journal.event(
                connection=0,
                direction="in",
                kind="PUBLISH",
                origin="kit",
                client_id=KIT,
                # A poke may publish on a topic that is no UTF-8; JSON can show it with its bytes escaped only.
                topic=packet.topic.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace"),
                **message_fields(packet.topic, packet.payload),
                qos=packet.qos,
                retain=packet.retain,
                dup=False,
                packet_id=None,
            )
        self.broker.publish(packet, KIT)

    async def _burst(self, burst: Burst) -> None:
        if not burst.brief:
            await self._publish_all(burst)
            return
        counted = self.broker.counted = Counter()
        try:
            await self._publish_all(burst)
        finally:
            self.broker.counted = None
        self.journal.event(
            connection=0,
            direction="in",
            kind="BURST",
            origin="kit",
            client_id=KIT,
            topic=burst.topic,
            count=burst.count,
        )
        for (connection, origin, client_id), count in counted.items():
            self.journal.event(
                connection=connection,
                direction="out",
                kind="BURST",
                origin=origin,
                client_id=client_id,
                topic=burst.topic,
                count=count,
            )

    async def _publish_all(self, burst: Burst) -> None:
        loop = asyncio.get_running_loop()
        began = loop.time()
        for number in range(burst.count):
            self._publish(burst.message(number))
            if burst.rate_per_s:
                await asyncio.sleep(max(0.0, began + (number + 1) / burst.rate_per_s - loop.time()))
            elif number % BURST_TURN == BURST_TURN - 1:
                await asyncio.sleep(0)

    def fault(self, rules: list[dict[str, Any]]) -> list[int]:
        plan = FaultPlan(rules)
        hits, self.broker.faults = self.broker.faults.hits, plan
        return hits

    async def reset(self) -> None:
        self.broker.faults = FaultPlan([])
        self.network.restored()
        self.broker.accounts.restored()
        self.broker.forget()
        self._answering.clear()
        await self.edge_node.reset()

    async def tick(self) -> None:
        await self.edge_node.tick()
