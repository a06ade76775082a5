"""The edge nodes on the broker as a listening host knows them: births, deaths, last values.

After a gap in the sequence, after the node's death and after an interruption of the adapter's own connection it is unknown
which messages were missed. The listing says so until the next birth. The tracker does not ask for births, because the
request is a command: a user who wants them publishes NCMD ``Node Control/Rebirth``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..core import AdapterError, exact_in_json
from .connection import Message
from .payload import DecodedMetric, Payload, decode
from .payload import Metric as NewMetric
from .shapes import KnownDevice
from .topics import NAMESPACE

__all__ = ["LISTENING", "NodeTracker"]

LISTENING = f"{NAMESPACE}/#"
"""The filter that selects every message that the tracker needs."""

MAX_HELD = 10_000
"""Limit for nodes, devices and metrics together; births beyond it are ignored."""

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
        status: ``online``, ``offline``, or ``unknown`` when its birth was not seen, or messages may have been missed since.
        gap: True when a sequence number was missing since the birth.
        last: topic, seq and timestamp of the last message, to recognise one that overlapping subscriptions deliver twice.
    """

    status: str = "unknown"
    bd_seq: int | None = None
    seq: int | None = None
    gap: bool = False
    own: _Device = field(default_factory=_Device)
    devices: dict[str, _Device] = field(default_factory=dict)
    last: tuple[str, int | None, int | None] | None = None


class NodeTracker:
    """The tracker of the edge nodes and devices seen since the listening began.

    Attributes:
        listening: True when the adapter is subscribed to :data:`LISTENING`.
        overfull: True when a birth was ignored because of :data:`MAX_HELD`.
    """

    def __init__(self) -> None:
        self.listening = False
        self.overfull = False
        self._nodes: dict[tuple[str, str], _Node] = {}

    # -- receiving ----------------------------------------------------------------------------------------

    def interrupted(self) -> None:
        """Note an interruption of the connection: births, deaths and data may have been missed."""
        for node in self._nodes.values():
            node.status, node.seq = "unknown", None

    def received(self, message: Message) -> None:
        """Take a message into account; messages that are not Sparkplug are ignored."""
        parts = message.topic.split("/")
        known_topic = parts[0] == NAMESPACE and len(parts) in _KINDS and parts[2] in _KINDS[len(parts)]
        if not self.listening or not known_topic:
            return
        _, group, kind, name, *device = parts
        node = self._nodes.get((group, name)) or _Node()
        if node.status == "offline" and kind != "NBIRTH":
            # No message is valid for a node that is dead.
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
        _follow_sequence(node, payload, first=kind == "NBIRTH")
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

    # -- reporting ----------------------------------------------------------------------------------------

    def listing(self) -> list[dict[str, Any]]:
        """Return every node, by group and name."""
        return [
            {
                "group_id": group,
                "edge_node_id": name,
                "status": node.status,
                "bd_seq": exact_in_json(node.bd_seq),
                "sequence_gap": node.gap,
                "metrics": _listed(node.own),
                "devices": [_told(node, device) for device in sorted(node.devices)],
            }
            for (group, name), node in sorted(self._nodes.items())
        ]

    def device(self, group: str, name: str, device: str) -> KnownDevice:
        """Return a device; one that was not heard of is offline and has no metrics."""
        return _told(self._nodes.get((group, name)) or _Node(), device)

    def check_command(self, group: str, name: str, device: str | None, metrics: list[NewMetric]) -> bool:
        """Compare names and types of a command with the birth (operational-behavior-data-commands-ncmd-metric-name).

        Returns:
            True when there is a birth to compare with.

        Raises:
            AdapterError: ``illegal_address`` or ``type_mismatch``: they differ.
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


def _told(node: _Node, device: str) -> KnownDevice:
    about = node.devices.get(device) or _Device()
    return {"device_id": device, "online": node.status == "online" and about.online, "metrics": _listed(about)}


def _bd_seq(payload: Payload) -> int | None:
    value = next((metric["value"] for metric in payload.metrics if metric["name"] == "bdSeq"), None)
    return value if isinstance(value, int) else None


def _follow_sequence(node: _Node, payload: Payload, *, first: bool) -> None:
    """Take the sequence number of a message into account; ``first`` is True for NBIRTH, with which a life begins."""
    if first:
        node.devices.clear()
        node.status, node.gap, node.bd_seq = "online", False, _bd_seq(payload)
    elif node.seq is not None and payload.seq != (node.seq + 1) % 256:
        node.gap = True
    node.seq = payload.seq


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
        # A metric that the birth did not declare is ignored.
        if metric["name"] in metrics:
            born = metrics[metric["name"]]
            new: DecodedMetric = {**metric, "alias": born["alias"], "datatype": born["datatype"]}
            metrics[metric["name"]] = new
            if isinstance(new["alias"], int):
                metrics[new["alias"]] = new


def _listed(about: _Device) -> list[DecodedMetric]:
    return [metric for key, metric in about.metrics.items() if isinstance(key, str)]
