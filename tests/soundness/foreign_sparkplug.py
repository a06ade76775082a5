"""Two Sparkplug B host applications of foreign shape, and their lies.

``mqtt-host``: knows groups; connects again by itself, asks unknown nodes for their births, publishes its STATE, and checks a command
against the births; lists nodes, gives the metrics of a device, and asks the broker for its status. Structured content.
``mqtt-listener``: belongs to one group, publishes no STATE, gives the metrics of a device, and has no status. Text in JSON.
"""

from __future__ import annotations

import asyncio
import json
import math
import os
import threading
import time
from typing import Any

import paho.mqtt.client as paho
from foreign import Failure, Result, Shape, prose, structured

from pytest_otmcp.wire.mqtt.sparkplug import DATA_TYPES, decode_message, payload_class

NAMESPACE, HOST_ID = "spBv1.0", "foreign-host"
STATE = f"{NAMESPACE}/STATE/{HOST_ID}"
REBIRTH = "Node Control/Rebirth"
ANSWER_S = 3.0
SCALARS = {
    **dict.fromkeys(("Int8", "Int16", "Int32", "UInt8", "UInt16", "UInt32"), (int, "int_value")),
    **dict.fromkeys(("Int64", "UInt64", "DateTime"), (int, "long_value")),
    "Float": (float, "float_value"),
    "Double": (float, "double_value"),
    "Boolean": (bool, "boolean_value"),
    "String": (str, "string_value"),
}


def now() -> int:
    return time.time_ns() // 1_000_000


def encoded(metrics: list[dict[str, Any]], seq: int | None = None) -> bytes:
    """Return the payload of a command."""
    payload = payload_class()(timestamp=now())
    for given in metrics:
        kind, carrier = SCALARS[given["datatype"]]
        bits = 64 if carrier == "long_value" else 32
        value = given["value"] % 2**bits if kind is int else given["value"]
        datatype = DATA_TYPES.index(given["datatype"])
        payload.metrics.add(name=given["name"], timestamp=now(), datatype=datatype, **{carrier: value})
    if seq is not None:
        payload.seq = seq
    return bytes(payload.SerializeToString())


def checked(metrics: Any) -> list[dict[str, Any]]:
    """Return the metrics of a command, or say what is wrong with them."""
    if not isinstance(metrics, list) or not metrics:
        raise Failure("invalid", "metrics must be a list of objects with name, datatype and value")
    for one in metrics:
        if not isinstance(one, dict) or one.keys() != {"name", "datatype", "value"} or not isinstance(one["name"], str):
            raise Failure("invalid", "each metric needs name, datatype and value")
        kind = SCALARS.get(str(one["datatype"]), (None, ""))[0]
        fits = type(one["value"]) is kind or (kind is float and type(one["value"]) is int)
        if not fits or (kind is float and not math.isfinite(one["value"])):
            raise Failure("invalid", f"{one['value']!r} is no {one['datatype']}")
    return metrics


def level(what: str, name: Any) -> str:
    if not isinstance(name, str) or not name or {"/", "+", "#", "\0"}.intersection(name):
        raise Failure("invalid", f"{what} must be one level of a topic")
    return name


Known = dict[str, dict[str, Any]]
"""Metrics by name, and by ``@`` and alias."""


class Node:
    """What is known of an edge node."""

    def __init__(self) -> None:
        self._forget()

    def _forget(self) -> None:
        self.online, self.gap = False, False
        self.seq: int | None = None
        self.bd_seq: object = None
        self.own: Known = {}
        self.devices: dict[str, tuple[bool, Known]] = {}

    def born(self, message: dict[str, Any]) -> None:
        self._forget()
        self.online, self.seq, self.own = True, message["seq"], known(message)
        self.bd_seq = bd_seq(message)


def known(message: dict[str, Any]) -> Known:
    metrics: Known = {}
    for metric in message["metrics"]:
        metrics[metric["name"]] = metric
        if metric["alias"] is not None:
            metrics[f"@{metric['alias']}"] = metric
    return metrics


def bd_seq(message: dict[str, Any]) -> object:
    return next((metric["value"] for metric in message["metrics"] if metric["name"] == "bdSeq"), None)


class Host:
    """A host application at one broker, in one group or in all."""

    def __init__(self, lie: str | None, *, group: str | None, state: bool) -> None:
        self._lie = lie
        self._filter = f"{NAMESPACE}/{group or '+'}/#"
        self._state = state
        self._births = 0
        self.nodes: dict[tuple[str, str], Node] = {}
        self._asked: set[tuple[str, str]] = set()
        self._kept: list[tuple[str, bytes]] = []
        self._ready, self._answered = False, set[int]()
        self._changed = threading.Condition()
        self._stamp = 0
        self.client = paho.Client(paho.CallbackAPIVersion.VERSION2, reconnect_on_failure=True)
        self.client.reconnect_delay_set(0.05, 0.1)
        self.client.on_pre_connect = self._before
        self.client.on_connect = self._connected
        self.client.on_subscribe = self._subscribed
        self.client.on_disconnect = self._lost
        self.client.on_message = self._received
        self.client.on_unsubscribe = lambda client, data, mid, codes, properties: self._answer(mid)
        self.client.connect_async(os.environ["BROKER_HOST"], int(os.environ["BROKER_PORT"]), keepalive=30)
        self.client.loop_start()

    # -- the connection -----------------------------------------------------------------------------------

    def _before(self, client: paho.Client, data: Any) -> None:
        # The birth has the time of the will (tck-id-host-topic-phid-birth-payload-timestamp): none of before may come again.
        client._out_messages.clear()
        self._stamp = now()
        if self._state and self._lie != "no-will":
            client.will_set(STATE, self._told(online=False), qos=1, retain=True)

    def _told(self, *, online: bool) -> str:
        return json.dumps({"online": online, "timestamp": self._stamp})

    def _connected(self, client: paho.Client, data: Any, flags: Any, code: Any, properties: Any) -> None:
        if code.is_failure:
            return
        client.subscribe([(STATE, 1), (self._filter, 0)] if self._state else [(self._filter, 0)])

    def _subscribed(self, client: paho.Client, data: Any, mid: int, codes: Any, properties: Any) -> None:
        self._births += 1
        if self._state and not (self._lie == "state-once" and self._births > 1):
            if self._lie == "other-timestamp":
                self._stamp += 1
            client.publish(STATE, self._told(online=True), qos=1, retain=self._lie != "state-not-retained")
        with self._changed:
            self._ready = True
            self._changed.notify_all()
        while self._kept:
            client.publish(*self._kept.pop(0), qos=0)

    def _lost(self, client: paho.Client, data: Any, flags: Any, code: Any, properties: Any) -> None:
        with self._changed:
            self._ready = False
            # What was missed meanwhile is not known.
            self.nodes.clear()
            self._asked.clear()
            self._changed.notify_all()

    def _answer(self, mid: int) -> None:
        with self._changed:
            self._answered.add(mid)
            self._changed.notify_all()

    def require(self) -> None:
        """Wait for a connection that has just been begun."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._ready, 0.5):
                raise Failure("offline", "not connected")

    def check(self) -> None:
        """Ask the broker for something that changes nothing."""
        self.require()
        mid = self.client.unsubscribe("foreign/nobody")[1]
        with self._changed:
            self._changed.wait_for(lambda: mid in self._answered or not self._ready, ANSWER_S)
            if mid not in self._answered:
                raise Failure("offline", "not connected: the broker does not answer")

    # -- the nodes ----------------------------------------------------------------------------------------

    def _received(self, client: paho.Client, data: Any, packet: paho.MQTTMessage) -> None:
        if packet.topic == STATE:
            if json.loads(packet.payload).get("online") is False and self._lie not in (
                "believes-its-death",
                "state-once",
            ):
                # Somebody else's will, or its own of before (tck-id-operational-behavior-host-application-...).
                client.publish(STATE, self._told(online=True), qos=1, retain=True)
            return
        message = decode_message(packet.topic, packet.payload)
        if message is None or "error" in message:
            return
        with self._changed:
            self._follow((message["group"], message["edge_node"]), message)

    def _follow(self, key: tuple[str, str], message: dict[str, Any]) -> None:
        kind, device = message["type"], message["device"]
        node = self.nodes.get(key)
        if kind == "NBIRTH":
            self.nodes.setdefault(key, Node()).born(message)
            self._asked.discard(key)
            return
        if kind == "NDEATH":
            if node is not None and node.bd_seq == bd_seq(message):
                node.online = False
            return
        if kind in ("NCMD", "DCMD"):
            return
        if node is None or not node.online:
            self._ask_for_births(key)
            return
        node.gap = node.gap or message["seq"] != ((node.seq or 0) + 1) % 256
        node.seq = message["seq"]
        if kind == "DBIRTH":
            node.devices[device] = (True, known(message))
        elif kind == "DDEATH":
            node.devices[device] = (False, node.devices.get(device, (False, {}))[1])
        else:
            metrics = node.own if device is None else node.devices.get(device, (True, {}))[1]
            for metric in message["metrics"]:
                born = metrics.get(metric["name"] or f"@{metric['alias']}")
                if born is not None:
                    datatype = born["datatype"]
                    value = metric["value"]
                    if metric["datatype"] is None and isinstance(value, int) and DATA_TYPES[datatype].startswith("Int"):
                        bits = 64 if DATA_TYPES[datatype] == "Int64" else 32
                        value = value - 2**bits if value >= 2 ** (bits - 1) else value
                    born["value"] = value

    def _ask_for_births(self, key: tuple[str, str]) -> None:
        if key not in self._asked:
            self._asked.add(key)
            rebirth = [{"name": REBIRTH, "datatype": "Boolean", "value": True}]
            self.client.publish(f"{NAMESPACE}/{key[0]}/NCMD/{key[1]}", encoded(rebirth), qos=0)

    def metrics(self, group: str, node: str, device: str | None) -> tuple[bool, Known]:
        with self._changed:
            found = self.nodes.get((group, node))
            if found is None or (device is not None and device not in found.devices):
                raise Failure("unknown", f"unknown node or device {group}/{node}/{device}")
            alive, metrics = (True, found.own) if device is None else found.devices[device]
            return found.online and alive, {name: dict(one) for name, one in metrics.items() if name[0] != "@"}

    # -- commands -----------------------------------------------------------------------------------------

    def command(self, group: Any, node: Any, device: Any, given: Any) -> None:
        if self._lie == "any-group" and not group:
            group = "factory"
        names = [level("group", group), level("node", node)]
        if device is not None and not (self._lie == "devices-of-levels" and device):
            level("device", device)
        metrics = checked(given)
        topic = "/".join(
            [NAMESPACE, names[0], "NCMD" if device is None else "DCMD", names[1], *([device] if device else [])]
        )
        payload = encoded(metrics, 7 if self._lie == "numbers-commands" else None)
        try:
            self.require()
            if self._lie == "answers-first":
                threading.Timer(0.03, self.client.publish, (topic, payload)).start()
                return
            if "/" in str(device):
                self.client.publish(topic, payload, qos=0)
                return
            alive, declared = self.metrics(group, node, device)
        except Failure as failure:
            if self._lie in ("sends-it-later", "says-sent") and failure.kind == "offline":
                self._kept.append((topic, payload))
                if self._lie == "says-sent":
                    return
            raise
        for one in metrics:
            if self._lie == "any-metric":
                break
            if not alive or one["name"] not in declared:
                raise Failure("unknown", f"{one['name']} is not declared by a birth")
            if DATA_TYPES[declared[one["name"]]["datatype"]] != one["datatype"]:
                raise Failure("mismatch", f"{one['name']} is of another type")
        if self._lie == "all-nodes":
            topic = topic.replace(f"/{node}", f"/{node}-2")
        if self._lie == "a-moment-later":
            threading.Timer(0.005, self.client.publish, (topic, payload)).start()
            return
        for _ in range(2 if self._lie == "sends-twice" else 1):
            info = self.client.publish(topic, payload, qos=0, retain=self._lie == "retained-commands")
            if info.rc:
                raise Failure("lost", "connection lost")


def listed(metrics: Known) -> list[dict[str, Any]]:
    return [{"name": name, "value": one["value"]} for name, one in metrics.items()]


def mqtt_host(lie: str | None, read_only: bool) -> Shape:
    host = Host(lie, group=None, state=True)

    async def did(work: Any, *given: Any, writes: bool = False) -> Result:
        try:
            if writes and read_only and lie != "unguarded":
                raise Failure("read-only", "observation mode")
            document = await asyncio.to_thread(work, *given)
        except Failure as failure:
            return structured({"error": {"kind": failure.kind, "message": str(failure)}}, is_error=True)
        return structured({"ok": True} if document is None else document)

    async def connection_status() -> Result:
        return await did(lambda: host.check() or {"connected": True, "host_id": HOST_ID})

    async def list_edge_nodes() -> Result:
        def nodes() -> dict[str, Any]:
            with host._changed:
                return {"nodes": [described(*one) for one in host.nodes.items()]}

        return await did(nodes)

    def described(key: tuple[str, str], node: Node) -> dict[str, Any]:
        return {
            "group_id": key[0],
            "edge_node_id": key[1],
            "status": "online" if node.online else "offline",
            "bd_seq": node.bd_seq,
            "gap": node.gap,
            "metrics": listed({name: one for name, one in node.own.items() if name[0] != "@"}),
            "devices": [
                {
                    "device_id": name,
                    "online": node.online and alive,
                    "metrics": listed({label: one for label, one in metrics.items() if label[0] != "@"}),
                }
                for name, (alive, metrics) in node.devices.items()
            ],
        }

    async def get_device_metrics(group_id: str = "", edge_node_id: str = "", device_id: str = "") -> Result:
        def metrics() -> dict[str, Any]:
            alive, found = host.metrics(group_id, edge_node_id, device_id)
            return {"online": alive, "metrics": {name: {"value": one["value"]} for name, one in found.items()}}

        return await did(metrics)

    async def send_node_command(group_id: Any = None, edge_node_id: Any = None, metrics: Any = None) -> Result:
        return await did(host.command, group_id, edge_node_id, None, metrics, writes=True)

    async def send_device_command(
        group_id: Any = None, edge_node_id: Any = None, device_id: Any = None, metrics: Any = None
    ) -> Result:
        device = "" if device_id is None else device_id
        return await did(host.command, group_id, edge_node_id, device, metrics, writes=True)

    node = {"group_id": "string", "edge_node_id": "string"}
    device = {**node, "device_id": "string"}
    metrics = {"metrics": {"type": "array", "items": {"type": "object"}}}
    return Shape(
        tools={
            "connection_status": ({}, connection_status),
            "list_edge_nodes": ({}, list_edge_nodes),
            "get_device_metrics": (device, get_device_metrics),
            "send_node_command": ({**node, **metrics}, send_node_command),
            "send_device_command": ({**device, **metrics}, send_device_command),
        },
        strict=True,
    )


def mqtt_listener(lie: str | None, read_only: bool) -> Shape:
    host = Host(lie, group="factory", state=False)

    async def did(work: Any, *given: Any) -> Result:
        try:
            return prose(json.dumps(await asyncio.to_thread(work, *given)))
        except Failure as failure:
            return prose(f"Error: {failure.kind}: {failure}", is_error=True)

    async def get_device_values(node: str, device: str) -> Result:
        def metrics() -> list[dict[str, Any]]:
            return listed(host.metrics("factory", node, device)[1])

        return await did(metrics)

    async def set_device_metrics(node: Any, device: Any, values: Any) -> Result:
        return await did(host.command, "factory", node, device, values)

    target = {"node": "string", "device": "string"}
    return Shape(
        tools={
            "get_device_values": (target, get_device_values),
            "set_device_metrics": (
                {**target, "values": {"type": "array", "items": {"type": "object"}}},
                set_device_metrics,
            ),
        },
        strict=True,
    )
