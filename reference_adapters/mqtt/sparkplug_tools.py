"""The Sparkplug B tools: the adapter's own edge node, commands to others, and listening as a host."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Any

from ..core import AdapterError, Call, Nothing, device_text, exact_in_json, tool
from .connection import Message
from .edge_node import Life, declared
from .link import Link
from .nodes import LISTENING
from .payload import DecodedMetric, Metric, check_value, decode, encode
from .shapes import (
    Base64Payload,
    Commanded,
    DecodedPayload,
    Device,
    DeviceBirth,
    DeviceCommand,
    DeviceData,
    DeviceDied,
    DevicePublished,
    ForeignDevice,
    KnownDevice,
    KnownNodes,
    NodeBirth,
    NodeCommand,
    NodeData,
    NodeDied,
    NodePublished,
    TypedMetric,
)
from .topics import NAMESPACE

__all__ = ["SparkplugTools"]


class SparkplugTools:
    """The Sparkplug tools over one connection to a broker; the edge node is the link's."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self._node = link.edge_node
        # These are subscribed to before the first birth (message-flow-edge-node-ncmd-subscribe,
        # -device-dcmd-subscribe).
        self._commands = {self._node.topic("NCMD"): 1, self._node.topic("DCMD", "+"): 1}
        self._listening_since = ""

    # -- births and deaths --------------------------------------------------------------------------------

    @tool("sparkplug.node_birth", writes=True, idempotent=False)
    async def publish_node_birth(self, call: Call, arguments: NodeBirth) -> NodePublished:
        """Publish NBIRTH and the DBIRTH of every device that is born."""
        node, metrics = self._node, declared(_checked(arguments.metrics))
        async with self._link.publishing:
            await self._link.need(call, self._commands)
            life = (node.life or Life()).with_node(metrics)
            seq = await self._publish(call, "NBIRTH", None, lambda: node.births(life))
            node.life = life
        return {"edge_node_id": node.name, "metric_count": len(metrics), "seq": seq, "bd_seq": node.bd_seq}

    @tool("sparkplug.node_death", writes=True)
    async def publish_node_death(self, call: Call, arguments: Nothing) -> NodeDied:
        """Publish NDEATH. The devices die with the node; all have to be born again before data."""
        node = self._node
        async with self._link.publishing:
            node.living()
            await self._publish(call, "NDEATH", None, lambda: [node.death()])
            node.life = None
        return {"edge_node_id": node.name, "bd_seq": node.bd_seq}

    @tool("sparkplug.device_birth", writes=True, idempotent=False)
    async def publish_device_birth(self, call: Call, arguments: DeviceBirth) -> DevicePublished:
        """Publish DBIRTH of a device, with NBIRTH before it if the node is not born."""
        node, device, metrics = self._node, arguments.device_id, declared(_checked(arguments.metrics))
        async with self._link.publishing:
            await self._link.need(call, self._commands)
            life = (node.life or Life()).with_device(device, metrics)
            alone = node.alive
            seq = await self._publish(
                call,
                "DBIRTH",
                device,
                lambda: [node.numbered("DBIRTH", device, metrics.values())] if alone else node.births(life),
            )
            node.life = life
        return {"edge_node_id": node.name, "device_id": device, "metric_count": len(metrics), "seq": seq}

    @tool("sparkplug.device_death", writes=True)
    async def publish_device_death(self, call: Call, arguments: Device) -> DeviceDied:
        """Publish DDEATH of a device."""
        node, device = self._node, arguments.device_id
        async with self._link.publishing:
            node.living().metrics_of(device)
            seq = await self._publish(call, "DDEATH", device, lambda: [node.numbered("DDEATH", device, ())])
            node.life = node.living().without_device(device)
        return {"edge_node_id": node.name, "device_id": device, "seq": seq}

    # -- data ---------------------------------------------------------------------------------------------

    @tool("sparkplug.node_data", writes=True, idempotent=False)
    async def publish_node_data(self, call: Call, arguments: NodeData) -> NodePublished:
        """Publish NDATA with metrics that the birth declared."""
        seq = await self._publish_data(call, "NDATA", None, arguments)
        node, count = self._node, len(arguments.metrics)
        return {"edge_node_id": node.name, "metric_count": count, "seq": seq, "bd_seq": node.bd_seq}

    @tool("sparkplug.device_data", writes=True, idempotent=False)
    async def publish_device_data(self, call: Call, arguments: DeviceData) -> DevicePublished:
        """Publish DDATA with metrics that the device's birth declared."""
        device, count = arguments.device_id, len(arguments.metrics)
        seq = await self._publish_data(call, "DDATA", device, arguments)
        return {"edge_node_id": self._node.name, "device_id": device, "metric_count": count, "seq": seq}

    # -- commands -----------------------------------------------------------------------------------------

    @tool("sparkplug.node_command", writes=True, idempotent=False)
    async def publish_node_command(self, call: Call, arguments: NodeCommand) -> Commanded:
        """Publish NCMD to an edge node. Names and types are checked if its birth was seen (list_sparkplug_nodes)."""
        return await self._command(call, "NCMD", None, arguments)

    @tool("sparkplug.device_command", writes=True, idempotent=False)
    async def publish_device_command(self, call: Call, arguments: DeviceCommand) -> Commanded:
        """Publish DCMD to a device. Names and types are checked if its birth was seen (list_sparkplug_nodes)."""
        return await self._command(call, "DCMD", arguments.device_id, arguments)

    # -- listening ----------------------------------------------------------------------------------------

    @tool("sparkplug.nodes")
    async def list_sparkplug_nodes(self, call: Call, arguments: Nothing) -> KnownNodes:
        """List the edge nodes heard of, with their devices and last values. The first call begins to listen; births come
        when nodes connect, or after an NCMD with Node Control/Rebirth = true."""
        await self._listen(call)
        known = self._link.nodes
        if known.overfull:
            call.extra["truncated"] = {"returned": len(known.listing()), "total": None}
        nodes = _foreign(call, "/data/nodes", known.listing())
        return {"nodes": nodes, "listening_since": self._listening_since}

    @tool("sparkplug.device")
    async def read_sparkplug_device(self, call: Call, arguments: ForeignDevice) -> KnownDevice:
        """Return the last values of a device, as list_sparkplug_nodes does; one not heard of is offline without metrics."""
        await self._listen(call)
        group = self._node.group if arguments.group_id is None else arguments.group_id
        told = self._link.nodes.device(group, arguments.edge_node_id, arguments.device_id)
        return {**told, "metrics": _foreign(call, "/data/metrics", told["metrics"])}

    async def _listen(self, call: Call) -> None:
        """Have received what the broker had for this client before; begin to listen with the first call."""
        link = self._link
        if link.nodes.listening:
            await link.ask(call)
            return
        since = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        await link.need(call, {LISTENING: 0})
        link.nodes.listening, self._listening_since = True, since

    @tool("sparkplug.decode")
    async def decode_sparkplug_payload(self, call: Call, arguments: Base64Payload) -> DecodedPayload:
        """Decode a Sparkplug B payload. Metrics that only have an alias keep it: names are in the birth."""
        try:
            data = base64.b64decode(arguments.payload, validate=True)
        except ValueError:
            raise AdapterError("invalid_input", "the payload is not base64", field="/payload") from None
        payload = decode(data)
        if payload.total > len(payload.metrics):
            call.extra["truncated"] = {"returned": len(payload.metrics), "total": payload.total}
        metrics: list[DecodedMetric] = _foreign(call, "/data/metrics", payload.metrics)
        return {"seq": exact_in_json(payload.seq), "timestamp": exact_in_json(payload.timestamp), "metrics": metrics}

    # -- publishing ---------------------------------------------------------------------------------------

    async def _publish(self, call: Call, kind: str, device: str | None, compose: Callable[[], list[Message]]) -> int:
        """Publish as edge node and return the sequence number of the message that the call is about."""
        node, seq = self._node, 0
        call.changes((node.topic(kind, device), None))

        def composed() -> list[Message]:
            nonlocal seq
            messages = compose()
            seq = 0 if kind == "NBIRTH" else node.seq
            call.trace.update(group=node.group, edge_node=node.name, type=kind, bd_seq=node.bd_seq)
            if device is not None:
                call.trace["device"] = device
            if kind != "NDEATH":
                call.trace["seq"] = seq
            return messages

        await self._link.publish(call, composed)
        call.trace["topic"] = node.topic(kind, device)
        return seq

    async def _publish_data(self, call: Call, kind: str, device: str | None, arguments: NodeData | DeviceData) -> int:
        node = self._node
        async with self._link.publishing:
            metrics = node.new_values(device, [(metric.name, metric.value) for metric in arguments.metrics])
            seq = await self._publish(call, kind, device, lambda: [node.numbered(kind, device, metrics)])
            node.remember(device, metrics)
        return seq

    async def _command(self, call: Call, kind: str, device: str | None, arguments: NodeCommand) -> Commanded:
        metrics, target = _checked(arguments.metrics), arguments.edge_node_id
        declared(metrics, own=())
        group = self._node.group if arguments.group_id is None else arguments.group_id
        known = self._link.nodes.check_command(group, target, device, metrics)
        topic = f"{NAMESPACE}/{group}/{kind}/{target}" + ("" if device is None else f"/{device}")

        call.changes((topic, None))

        def compose() -> list[Message]:
            call.trace.update(group=group, edge_node=target, type=kind)
            if device is not None:
                call.trace["device"] = device
            # Commands carry no sequence number (payloads-ncmd-seq, payloads-dcmd-seq).
            return [Message(topic=topic, payload=encode(metrics, None))]

        await self._link.publish(call, compose)
        return {
            "topic": topic,
            "metric_count": len(metrics),
            "delivery": call.trace["delivery"],
            "checked_against_birth": known,
        }


def _checked(metrics: Sequence[TypedMetric]) -> list[Metric]:
    for index, metric in enumerate(metrics):
        check_value(metric.datatype, metric.value, f"/metrics/{index}/value")
    return [Metric(name=metric.name, datatype=metric.datatype, value=metric.value) for metric in metrics]


def _foreign(call: Call, pointer: str, value: Any) -> Any:
    """Return a copy with every text cleaned, listed as one in ``meta.untrusted``; base64 is not changed."""
    if isinstance(value, str):
        value = device_text(call, pointer, value)
    elif isinstance(value, list):
        value = [_foreign(call, pointer, member) for member in value]
    elif isinstance(value, dict):
        raw = value.get("encoding") == "base64"
        value = {
            name: member if raw and name == "value" else _foreign(call, pointer, member)
            for name, member in value.items()
        }
    call.extra["untrusted"] = [pointer]
    return value
