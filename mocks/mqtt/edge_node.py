"""A Sparkplug 3.0 edge node with two devices, beside plain topics, on a connection to any broker.

============================  ===========================================================================================
``spBv1.0/factory/…``         births, DDATA every tick, NDEATH will; executes NCMD rebirth and scan rate, and DCMD of writable
                              metrics
``sensors/{…}``               temperature, pressure, humidity every tick: ``{"value": 20.0, "unit": "degC"}``
``system/status``             retained: ``{"online": true}``
``control/#``                 subscribed; the last payload on each topic is kept
============================  ===========================================================================================
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Mapping
from typing import Any

from pytest_otmcp.wire.mqtt.packets import MQTT_311, Connect, Publish, Will
from pytest_otmcp.wire.mqtt.sparkplug import decode_message

from ..journal import Direction
from .client import Client, Dial, Observer
from .edge_node_pokes import Births, EdgeNodePoke, read_poke
from .plant import Plant, Tag
from .sparkplug import DATATYPES, encode_payload
from .sparkplug_values import json_safe

__all__ = ["CLIENT_ID", "EdgeNode"]

GROUP, NODE = "factory", "edge-node-1"
CLIENT_ID = f"otmcp-mock-{NODE}"

_REBIRTH, _SCAN_RATE = "Node Control/Rebirth", "Node Control/Scan Rate"

_RECONNECT_S = 0.05
_DATATYPE_NAMES = {number: name for name, number in DATATYPES.items()}


def _ignore(direction: Direction, frame: bytes) -> None:
    """Do nothing with a packet."""


class EdgeNode:
    """An edge node that connects, publishes births and data, executes commands, and connects again after a loss.

    Attributes:
        scan_rate: milliseconds between two looks at the devices; kept, and followed by nobody.
        seq: number of the last message; bd_seq: that of this connection's birth and death.
        controls: last payload by topic below ``control/``, as text.
    """

    def __init__(self, observe: Observer = _ignore) -> None:
        self._observe = observe
        self.plant = Plant()
        self.scan_rate = Tag(datatype="Int64", value=1_000, writable=True)
        self.seq = 0
        self.bd_seq = -1
        self.controls: dict[str, str] = {}
        self._births_have = Births()
        self._online = asyncio.Event()
        self._online.set()
        self._dial: Dial
        self._client: Client | None = None
        self._keeper: asyncio.Task[None] | None = None
        self._born = asyncio.Event()

    # -- life ---------------------------------------------------------------------------------------------

    async def start(self, dial: Dial) -> None:
        """Connect and publish the births; connect in the same way whenever the connection has ended.

        Raises:
            OSError: the broker cannot be reached or refuses.
        """
        self._dial = dial
        await self._connect()
        self._keeper = asyncio.create_task(self._keep_connected(), name="edge-node")

    async def aclose(self) -> None:
        """End in an orderly way: NDEATH first, because a DISCONNECT discards the will (section 5.6)."""
        if self._keeper is not None:
            self._keeper.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._keeper
        client, self._client = self._client, None
        if client is not None and not client.closed.is_set():
            client.publish(self._topic("NDEATH"), self._death(), qos=1)
            await client.aclose()

    async def _connect(self) -> None:
        # One more with every CONNECT (tck-id-topics-nbirth-bdseq-increment).
        self.bd_seq = (self.bd_seq + 1) % 256
        connect = Connect(
            protocol_level=MQTT_311,
            clean_start=True,
            keepalive=0,
            client_id=CLIENT_ID,
            will=Will(topic=self._topic("NDEATH"), payload=self._death(), qos=1, retain=False),
        )
        client = await Client.connect(self._dial, connect, self._received, self._observe)
        # Commands are subscribed to before the birth (tck-id-message-flow-edge-node-ncmd-subscribe).
        await client.subscribe(self._topic("NCMD"), self._topic("DCMD", "+"), "control/#")
        self._client = client
        self._births()
        client.publish("system/status", b'{"online": true}', retain=True)
        await client.ping()
        self._born.set()

    async def _keep_connected(self) -> None:
        while True:
            if self._client is not None:
                await self._client.closed.wait()
                self._client = None
                self._born.clear()
            await self._online.wait()
            await asyncio.sleep(_RECONNECT_S)
            with contextlib.suppress(OSError):
                await self._connect()

    async def reset(self) -> None:
        """Restore the start-up values, and announce them by a rebirth.

        Raises:
            TimeoutError: there is no connection to the broker.
        """
        self.plant = Plant()
        self.scan_rate.value = 1_000
        self.controls.clear()
        self._births_have = Births()
        self._online.set()
        await asyncio.wait_for(self._born.wait(), 5.0)
        assert self._client is not None
        self._births()
        self._client.publish("system/status", b'{"online": true}', retain=True)
        await self._client.ping()

    async def tick(self) -> None:
        """Advance the plant by one second; return when the broker has handled the published messages."""
        changed = self.plant.tick()
        if self._client is None:
            return
        for device, tags in changed.items():
            self._publish("DDATA", device, tags)
        for name, reading in self.plant.sensors().items():
            self._client.publish(f"sensors/{name}", json.dumps(reading).encode())
        with contextlib.suppress(OSError):
            await self._client.ping()

    async def poke(self, params: Any) -> None:
        """Do what a poke of the node asks for, see :mod:`.edge_node_pokes`; return when the broker has handled it.

        Raises:
            ValueError: it is not understood, or the node is offline.
        """
        poke = read_poke(params, self.plant)
        if poke.offline is False:
            self._online.set()
            await asyncio.wait_for(self._born.wait(), 5.0)
        client = self._client
        if client is None:
            if poke.offline:
                return
            raise ValueError("the edge node is offline")
        self.seq = (self.seq + poke.skip_seq) % 256
        await self._announce(poke)
        if poke.death is not None:
            self._publish("DDEATH", poke.death, {})
        if poke.offline:
            self._online.clear()
        if poke.cut or poke.offline:
            client.cut()
            await client.closed.wait()
            self._client = None
            self._born.clear()
            if poke.cut:
                await asyncio.wait_for(self._born.wait(), 5.0)
        else:
            await client.ping()

    async def _announce(self, poke: EdgeNodePoke) -> None:
        """Take over metrics and the form of births, and publish what follows from them."""
        if poke.births is not None:
            self._births_have = poke.births
        for device, name, tag in poke.metrics:
            self.plant.devices.setdefault(device, {})[name] = tag
        if poke.births is not None or poke.new:
            self._births()
        elif poke.metrics:
            for device in dict.fromkeys(device for device, _, _ in poke.metrics):
                self._publish("DDATA", device, {name: tag for owner, name, tag in poke.metrics if owner == device})

    def points(self) -> dict[str, Any]:
        """Return the value of every tag as ``edge_node/<device>/<tag>``."""
        return {
            f"edge_node/{device}/{name}": json_safe(tag.value)
            for device, tags in self.plant.devices.items()
            for name, tag in tags.items()
        }

    def image(self) -> dict[str, Any]:
        """Return the values that the node holds, and its counters."""
        return {
            "group": GROUP,
            "edge_node": NODE,
            "connected": self._client is not None,
            "ticks": self.plant.ticks,
            "seq": self.seq,
            "bd_seq": self.bd_seq,
            "scan_rate": self.scan_rate.value,
            "devices": {
                device: {name: json_safe(tag.value) for name, tag in tags.items()}
                for device, tags in self.plant.devices.items()
            },
            "controls": dict(self.controls),
        }

    # -- Sparkplug ----------------------------------------------------------------------------------------

    @staticmethod
    def _topic(kind: str, device: str | None = None) -> str:
        return f"spBv1.0/{GROUP}/{kind}/{NODE}" + (f"/{device}" if device else "")

    def _death(self) -> bytes:
        # bdSeq alone, no sequence number (tck-id-topics-ndeath-seq, -payloads-ndeath-bdseq).
        return encode_payload([self._bd_seq()], timestamp=_now(), seq=None)

    def _bd_seq(self) -> dict[str, Any]:
        return {"name": "bdSeq", "datatype": "Int64", "value": self.bd_seq}

    def _publish(self, kind: str, device: str | None, tags: Mapping[str, Tag]) -> None:
        metrics = [self._metric(kind, device, name, tag) for name, tag in tags.items()]
        if kind == "NBIRTH":
            metrics.insert(0, self._bd_seq())
        self.seq = 0 if kind == "NBIRTH" else (self.seq + 1) % 256
        assert self._client is not None
        self._client.publish(self._topic(kind, device), encode_payload(metrics, timestamp=_now(), seq=self.seq))

    def _metric(self, kind: str, device: str | None, name: str, tag: Tag) -> dict[str, Any]:
        metric = {"name": name, "datatype": tag.datatype, "value": tag.value}
        if device is None or not self._births_have.aliases:
            return metric
        # The name is in the birth alone (tck-id-payloads-alias-data-cmd-requirement).
        alias = self._births_have.alias(device, name)
        return {**metric, "alias": alias} if kind == "DBIRTH" else {**metric, "name": None, "alias": alias}

    def _births(self) -> None:
        rebirth = Tag(datatype="Boolean", value=False)
        self._publish("NBIRTH", None, {_REBIRTH: rebirth, _SCAN_RATE: self.scan_rate})
        for device, tags in self.plant.devices.items():
            self._publish("DBIRTH", device, tags)

    def _received(self, packet: Publish) -> None:
        if packet.topic.startswith("control/"):
            self.controls[packet.topic] = packet.payload.decode("utf-8", "replace")
            return
        message = decode_message(packet.topic, packet.payload)
        if self._client is None or message is None or "error" in message:
            return
        metrics = message["metrics"]
        if message["type"] == "NCMD":
            if any(one["name"] == _REBIRTH and one["value"] is True for one in metrics):
                self._births()
            for one in metrics:
                if one["name"] == _SCAN_RATE and self.scan_rate.accepts(one["value"]):
                    self.scan_rate.value = one["value"]
                    self._publish("NDATA", None, {_SCAN_RATE: self.scan_rate})
            return
        done: dict[str, Tag] = {}
        for one in metrics:
            name = one["name"]
            if name is None:
                name = self._births_have.name(message["device"], one["alias"])
            datatype = None if one["datatype"] is None else _DATATYPE_NAMES.get(one["datatype"], "unknown")
            tag = self.plant.command(message["device"], name, datatype, one["value"])
            if tag is not None:
                done[name] = tag
        if done:
            self._publish("DDATA", message["device"], done)


def _now() -> int:
    return time.time_ns() // 1_000_000
