"""What the adapter knows of the edge nodes on the broker, as a host that listens: births, deaths, last values.

A value is only as good as what came before it. After a gap in the sequence, after the node's death and after an
interruption of our own connection nobody knows what was missed, and the listing says so; only a birth mends it. The
births are not asked for here, because asking is a command: whoever wants them publishes NCMD ``Node Control/Rebirth``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..core import AdapterError
from .connection import Message
from .payload import DecodedMetric, Payload, decode, exact
from .payload import Metric as NewMetric
from .topics import NAMESPACE

__all__ = ["LISTENING", "NodeTracker"]

LISTENING = f"{NAMESPACE}/#"
"""The filter under which everything arrives that the tracker needs."""

MAX_HELD = 10_000
"""Nodes, devices and metrics together; births beyond that are not taken in."""

_KINDS = {4: ("NBIRTH", "NDATA", "NDEATH"), 5: ("DBIRTH", "DDATA", "DDEATH")}

Metrics = dict[str | int, DecodedMetric]


@dataclass(slots=True, kw_only=True)
class _Device:
    """A device, or the metrics of the node itself; ``metrics`` by name and by alias."""

    online: bool = False
    metrics: Metrics = field(default_factory=dict)


@dataclass(slots=True, kw_only=True)
class _Node:
    """One edge node.

    Attributes:
        status: ``online``, ``offline``, or ``unknown`` when its birth was not seen, or something may have been missed
            since.
        gap: a sequence number was missing since the birth.
        last: topic, seq and timestamp of the last message, to recognise what overlapping subscriptions bring twice.
    """

    status: str = "unknown"
    bd_seq: int | None = None
    seq: int | None = None
    gap: bool = False
    own: _Device = field(default_factory=_Device)
    devices: dict[str, _Device] = field(default_factory=dict)
    last: tuple[str, int | None, int | None] | None = None


class NodeTracker:
    """Edge nodes and devices seen since the listening began.

    Attributes:
        listening: the adapter is subscribed to :data:`LISTENING`.
        overfull: there was more than can be held.
    """

    def __init__(self) -> None:
        self.listening = False
        self.overfull = False
        self._nodes: dict[tuple[str, str], _Node] = {}

    # -- hearing ------------------------------------------------------------------------------------------

    def interrupted(self) -> None:
        """There was no connection for a while: births, deaths and data may have been missed."""
        for node in self._nodes.values():
            node.status, node.seq = "unknown", None

    def received(self, message: Message) -> None:
        """Take a message into account; what is not Sparkplug is ignored."""
        parts = message.topic.split("/")
        if (
            not self.listening
            or parts[0] != NAMESPACE
            or len(parts) not in _KINDS
            or parts[2] not in _KINDS[len(parts)]
        ):
            return
        _, group, kind, name, *device = parts
        node = self._nodes.get((group, name)) or _Node()
        if node.status == "offline" and kind != "NBIRTH":
            # Nobody may speak for a node that is dead.
            return
        about = node.devices.get(device[0], _Device()) if device else node.own
        birth = kind.endswith("BIRTH")
        try:
            payload = decode(message.payload, None if birth else about.metrics)
        except AdapterError:
            return
        this = (message.topic, payload.seq, payload.timestamp)
        if node.last == this:
            return
        if (birth or (group, name) not in self._nodes) and self._held() + payload.total >= MAX_HELD:
            self.overfull = True
            return
        self._nodes[group, name] = node
        node.last = this
        if kind == "NDEATH":
            _die(node, payload)
            return
        if kind == "NBIRTH":
            node.devices.clear()
            node.status, node.gap, node.bd_seq = "online", False, _bd_seq(payload)
        elif node.seq is not None and payload.seq != (node.seq + 1) % 256:
            node.gap = True
        node.seq = payload.seq
        if kind == "DBIRTH":
            node.devices[device[0]] = about
        if birth:
            about.online, about.metrics = True, _by_key(payload)
        elif kind == "DDEATH":
            about.online = False
        else:
            _update(about.metrics, payload)

    def _held(self) -> int:
        return sum(
            1 + len(about.metrics) for node in self._nodes.values() for about in (node.own, *node.devices.values())
        )

    # -- telling ------------------------------------------------------------------------------------------

    def listing(self) -> list[dict[str, Any]]:
        """Every node, by group and name."""
        return [
            {
                "group_id": group,
                "edge_node_id": name,
                "status": node.status,
                "bd_seq": exact(node.bd_seq),
                "sequence_gap": node.gap,
                "metrics": _listed(node.own),
                "devices": [
                    {
                        "device_id": device,
                        "online": node.status == "online" and about.online,
                        "metrics": _listed(about),
                    }
                    for device, about in sorted(node.devices.items())
                ],
            }
            for (group, name), node in sorted(self._nodes.items())
        ]

    def check_command(self, group: str, name: str, device: str | None, metrics: list[NewMetric]) -> bool:
        """Names and types of a command agree with the birth (operational-behavior-data-commands-ncmd-metric-name).

        Returns:
            whether there is a birth to compare with.

        Raises:
            AdapterError: ``illegal_address`` or ``type_mismatch``.
        """
        node = self._nodes.get((group, name))
        about = None if node is None or node.status != "online" else node.devices.get(device) if device else node.own
        if about is None or not about.online:
            return False
        for index, metric in enumerate(metrics):
            born = about.metrics.get(metric.name)
            if born is None:
                message = "the birth of the edge node or device declares no such metric"
                raise AdapterError("illegal_address", message, outcome="not_sent", field=f"/metrics/{index}/name")
            if born["datatype"] != metric.datatype:
                message = "the birth of the edge node or device declares another datatype"
                raise AdapterError("type_mismatch", message, outcome="not_sent", field=f"/metrics/{index}/datatype")
        return True


def _bd_seq(payload: Payload) -> int | None:
    value = next((metric["value"] for metric in payload.metrics if metric["name"] == "bdSeq"), None)
    return value if isinstance(value, int) else None


def _die(node: _Node, payload: Payload) -> None:
    # The death of an earlier life may arrive after the birth of the next (host-action-ndeath, bdSeq).
    if node.status == "online" and node.bd_seq is not None and node.bd_seq != _bd_seq(payload):
        return
    node.status, node.seq = "offline", None


def _by_key(payload: Payload) -> Metrics:
    metrics: Metrics = {}
    for metric in payload.metrics:
        if metric["name"] is not None:
            metrics[metric["name"]] = metric
            if isinstance(metric["alias"], int):
                metrics[metric["alias"]] = metric
    return metrics


def _update(metrics: Metrics, payload: Payload) -> None:
    for metric in payload.metrics:
        # A name that no birth declared means nothing.
        if metric["name"] in metrics:
            born = metrics[metric["name"]]
            new: DecodedMetric = {**metric, "alias": born["alias"], "datatype": born["datatype"]}
            metrics[metric["name"]] = new
            if isinstance(new["alias"], int):
                metrics[new["alias"]] = new


def _listed(about: _Device) -> list[DecodedMetric]:
    return [metric for key, metric in about.metrics.items() if isinstance(key, str)]
