"""The adapter's own Sparkplug edge node: births before data, one sequence counter, bdSeq with the will.

Rules quoted by their identifiers in the Sparkplug 3.0 specification (``tck-id-…``).
"""

from __future__ import annotations

from typing import Any

from ..core import AdapterError
from .connection import Will
from .payload import Datatype, Metric, check_value, encode

__all__ = ["EdgeNode"]


class EdgeNode:
    """What the node has declared, and its counters. It knows what to publish, not how."""

    def __init__(self, group: str, name: str) -> None:
        self.group = group
        self.name = name
        self.wanted = False
        """The node has been born at somebody's wish: births are repeated after a reconnect."""
        self.born = False
        self._bd_seq = -1
        self._seq = 0
        self._node: dict[str, Metric] = {}
        self._devices: dict[str, dict[str, Metric]] = {}

    def topic(self, kind: str, device: str | None = None) -> str:
        """The topic of a message of this node."""
        return f"spBv1.0/{self.group}/{kind}/{self.name}" + ("" if device is None else f"/{device}")

    def new_connection(self) -> Will:
        """The will of the next CONNECT; bdSeq is one more than that of the last (payloads-ndeath-bdseq)."""
        self._bd_seq = (self._bd_seq + 1) % 256
        self.born = False
        return Will(topic=self.topic("NDEATH"), payload=self.death())

    def death(self) -> bytes:
        """NDEATH holds bdSeq alone and has no sequence number (topics-ndeath-payload, topics-ndeath-seq)."""
        return encode([self._bd_seq_metric()], None)

    def _bd_seq_metric(self) -> Metric:
        return ("bdSeq", "Int64", self._bd_seq)

    # -- births -------------------------------------------------------------------------------------------

    def declare_node(self, metrics: list[Metric]) -> None:
        """The metrics of the node's next birth."""
        self._node = {metric[0]: metric for metric in metrics}

    def declare_device(self, device: str, metrics: list[Metric]) -> None:
        """The metrics of a device's next birth."""
        self._devices[device] = {metric[0]: metric for metric in metrics}

    def undeclare_device(self, device: str) -> None:
        """A device died; it is born again only by a new declaration."""
        self._devices.pop(device, None)

    def declared(self, device: str) -> bool:
        """The device has been born."""
        return device in self._devices

    def node_birth(self) -> bytes:
        """NBIRTH: sequence number 0, bdSeq as in the will, and the rebirth control (topics-nbirth-*)."""
        self._seq = 0
        control: Metric = ("Node Control/Rebirth", "Boolean", False)
        return encode([self._bd_seq_metric(), control, *self._node.values()], 0)

    def all_births(self) -> list[tuple[str, bytes]]:
        """Topic and payload of NBIRTH and every DBIRTH, in the order in which they have to be sent."""
        births = [(self.topic("NBIRTH"), self.node_birth())]
        births += [(self.topic("DBIRTH", device), self.device_birth(device)) for device in self._devices]
        return births

    def device_birth(self, device: str) -> bytes:
        """DBIRTH of a declared device."""
        return self._numbered(list(self._devices[device].values()))

    # -- data ---------------------------------------------------------------------------------------------

    def node_metrics(self, values: list[tuple[str, Any]]) -> list[Metric]:
        """Values for NDATA with the datatypes of the birth; see :meth:`device_metrics`."""
        if not self.born:
            raise AdapterError("not_born", "the edge node has not been born; call publish_node_birth first")
        return self._typed(self._node, values)

    def device_metrics(self, device: str, values: list[tuple[str, Any]]) -> list[Metric]:
        """Values for DDATA with the datatypes of the birth.

        Raises:
            AdapterError: the device is not born, a metric was not declared, or a value does not fit.
        """
        if not self.born or device not in self._devices:
            raise AdapterError("not_born", "the device has not been born; call publish_device_birth first")
        return self._typed(self._devices[device], values)

    @staticmethod
    def _typed(declared: dict[str, Metric], values: list[tuple[str, Any]]) -> list[Metric]:
        metrics: list[Metric] = []
        for index, (name, value) in enumerate(values):
            if name not in declared:
                message = "the birth did not declare this metric"
                raise AdapterError("illegal_address", message, outcome="not_sent", field=f"/metrics/{index}/name")
            datatype: Datatype = declared[name][1]
            check_value(datatype, value, f"/metrics/{index}/value")
            metrics.append((name, datatype, value))
        return metrics

    def data(self, metrics: list[Metric]) -> bytes:
        """A data or death message with the next sequence number."""
        return self._numbered(metrics)

    def not_sent(self) -> None:
        """The message built last did not leave: its sequence number is used again."""
        self._seq = (self._seq - 1) % 256

    @property
    def seq(self) -> int:
        """The sequence number that was used last."""
        return self._seq

    @property
    def bd_seq(self) -> int:
        """The bdSeq of the connection."""
        return self._bd_seq

    def _numbered(self, metrics: list[Metric]) -> bytes:
        # One counter for all messages of the node, modulo 256 (payloads-sequence-num-incrementing).
        self._seq = (self._seq + 1) % 256
        return encode(metrics, self._seq)
