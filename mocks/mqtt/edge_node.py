"""A simulated plant on MQTT: plain topics, and a Sparkplug 3.0 edge node with two devices.

Everything it says is a function of the number of ticks. It is an ordinary client of the broker, so it can be pointed at
any broker.
"""

from __future__ import annotations

import json
import math
import time
from typing import Any

from .client import Client
from .sparkplug import DATATYPES, decode_message, encode_payload

__all__ = ["EdgeNode"]

GROUP, NODE = "factory", "edge-node-1"
CLIENT_ID = f"otmcp-mock-{NODE}"
_NAMES = {number: name for name, number in DATATYPES.items()}


class EdgeNode:
    """Births, data, commands, rebirth; ``tick`` advances it by a second."""

    def __init__(self) -> None:
        self.ticks = 0
        self.bd_seq = 0
        self.seq = 0
        self.controls: dict[str, str] = {}
        self.devices: dict[str, dict[str, tuple[str, Any]]] = {
            "device-1": {"temperature": ("Double", 20.0), "pressure": ("Double", 1.0), "setpoint": ("Double", 50.0)},
            "device-2": {"level": ("Double", 50.0), "running": ("Boolean", True), "count": ("Int64", 0)},
        }
        self._client: Client | None = None

    async def start(self, host: str, port: int) -> None:
        """Connect with the will, subscribe to commands, publish the births."""
        will = {
            "topic": self._topic("NDEATH"),
            "payload": encode_payload([self._bd_seq()], timestamp=_now(), seq=None),
            "qos": 1,
            "retain": False,
        }
        self._client = await Client.connect(host, port, CLIENT_ID, self._received, will)
        # Section 5.4: commands are subscribed to before the birth, with QoS 1.
        await self._client.subscribe(self._topic("NCMD"), self._topic("DCMD") + "/#", "control/#")
        self._births()
        self._client.publish("system/status", b'{"online": true}', qos=1, retain=True)

    def close(self) -> None:
        """An orderly end: NDEATH first, because a DISCONNECT discards the will (section 5.6)."""
        if self._client is not None:
            death = encode_payload([self._bd_seq()], timestamp=_now(), seq=None)
            self._client.publish(self._topic("NDEATH"), death, qos=1)
            self._client.close()
            self._client = None

    def tick(self) -> None:
        """One second: new sine values, DDATA of both devices, plain sensor topics."""
        self.ticks += 1
        if self._client is None:
            return
        wave = math.sin(self.ticks * 2 * math.pi / 60)
        self._set("device-1", temperature=20 + 5 * wave, pressure=1 + 0.2 * wave)
        self._set("device-2", level=50 + 30 * wave, count=self.devices["device-2"]["count"][1] + 1)
        for name, value in (("temperature", 20 + 5 * wave), ("pressure", 1 + 0.2 * wave), ("humidity", 45 + 10 * wave)):
            self._client.publish(f"sensors/{name}", json.dumps({"value": round(value, 3)}).encode())

    def image(self) -> dict[str, Any]:
        """What it holds and where its counters are."""
        devices = {
            name: {metric: value for metric, (_, value) in metrics.items()} for name, metrics in self.devices.items()
        }
        return {
            "group": GROUP,
            "edge_node": NODE,
            "seq": self.seq,
            "bd_seq": self.bd_seq,
            "devices": devices,
            "controls": dict(self.controls),
        }

    def _topic(self, kind: str, device: str | None = None) -> str:
        return f"spBv1.0/{GROUP}/{kind}/{NODE}" + (f"/{device}" if device else "")

    def _bd_seq(self) -> dict[str, Any]:
        return {"name": "bdSeq", "datatype": "Int64", "value": self.bd_seq}

    def _publish(self, kind: str, device: str | None, metrics: list[dict[str, Any]]) -> None:
        assert self._client is not None
        self.seq = 0 if kind == "NBIRTH" else (self.seq + 1) % 256
        self._client.publish(self._topic(kind, device), encode_payload(metrics, timestamp=_now(), seq=self.seq))

    def _births(self) -> None:
        rebirth = {"name": "Node Control/Rebirth", "datatype": "Boolean", "value": False}
        self._publish("NBIRTH", None, [self._bd_seq(), rebirth])
        for device, metrics in self.devices.items():
            self._publish("DBIRTH", device, _listed(metrics))

    def _set(self, device: str, **values: Any) -> None:
        metrics = self.devices[device]
        for name, value in values.items():
            metrics[name] = (metrics[name][0], value)
        self._publish("DDATA", device, _listed({name: metrics[name] for name in values}))

    def _received(self, topic: str, payload: bytes) -> None:
        if topic.startswith("control/"):
            self.controls[topic] = payload.decode("utf-8", "replace")
            return
        message = decode_message(topic, payload)
        if "error" in message:
            return
        if message["type"] == "NCMD":
            if any(metric["name"] == "Node Control/Rebirth" and metric["value"] for metric in message["metrics"]):
                self._births()
            return
        known = self.devices.get(message["device"], {})
        accepted = {
            metric["name"]: metric["value"]
            for metric in message["metrics"]
            if metric["name"] in known and _NAMES.get(metric["datatype"] or 0) == known[metric["name"]][0]
        }
        if accepted:
            self._set(message["device"], **accepted)


def _listed(metrics: dict[str, tuple[str, Any]]) -> list[dict[str, Any]]:
    return [{"name": name, "datatype": kind, "value": value} for name, (kind, value) in metrics.items()]


def _now() -> int:
    return time.time_ns() // 1_000_000
