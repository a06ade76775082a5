"""The adapter's own Sparkplug edge node: births before data, one sequence counter, bdSeq with the will.

The edge node composes messages and does not send them. Composing uses sequence numbers, so a composed message has to be
sent, or the connection has to end. The node's state (:attr:`EdgeNode.life`, :meth:`EdgeNode.remember`) changes only after a
message was delivered: a call that failed changes nothing, and a later birth does not publish that call's values.

Rules are quoted by their identifiers in the Sparkplug 3.0 specification (``tck-id-…``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..core import AdapterError
from .connection import Message, Will
from .payload import REBIRTH, Metric, check_value, encode
from .topics import NAMESPACE

__all__ = ["EdgeNode", "Life", "declared"]

Metrics = Mapping[str, Metric]

_BD_SEQ = "bdSeq"
_OWN = (_BD_SEQ, REBIRTH)


def declared(metrics: Sequence[Metric], own: tuple[str, ...] = _OWN) -> dict[str, Metric]:
    """Return the metrics of a birth or command by name.

    Args:
        metrics: the metrics.
        own: names that an edge node declares itself.

    Raises:
        AdapterError: ``invalid_input``: a name occurs twice, or is one of ``own``.
    """
    by_name: dict[str, Metric] = {}
    for index, metric in enumerate(metrics):
        if metric.name in by_name or metric.name in own:
            reason = "is there twice" if metric.name in by_name else "is declared by the edge node itself"
            raise AdapterError("invalid_input", f"a metric {reason}", field=f"/metrics/{index}/name")
        by_name[metric.name] = metric
    return by_name


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """The metrics that the births of a living node declare: its own, and those of its devices."""

    node: Metrics = field(default_factory=dict)
    devices: Mapping[str, Metrics] = field(default_factory=dict)

    def with_node(self, metrics: Metrics) -> Life:
        """Return a life with the same devices below a node with other metrics."""
        return Life(node=metrics, devices=self.devices)

    def with_device(self, device: str, metrics: Metrics) -> Life:
        """Return a life in which a device is born with these metrics, for the first time or again."""
        return Life(node=self.node, devices={**self.devices, device: metrics})

    def without_device(self, device: str) -> Life:
        """Return a life without a device."""
        return Life(node=self.node, devices={name: told for name, told in self.devices.items() if name != device})

    def metrics_of(self, device: str | None) -> Metrics:
        """Return the metrics that the node (None) or a device has declared.

        Raises:
            AdapterError: ``not_born``: the device has not been born.
        """
        if device is None:
            return self.node
        if device not in self.devices:
            raise AdapterError("not_born", "the device has not been born; call publish_device_birth first")
        return self.devices[device]


class EdgeNode:
    """The node's declared metrics and its counters.

    Attributes:
        life: the metrics of its births; None while it is not born. Its births are repeated after a reconnect.
    """

    def __init__(self, group: str, name: str) -> None:
        self.group = group
        self.name = name
        self.life: Life | None = None
        self.bd_seq = -1
        self.seq = 0

    @property
    def alive(self) -> bool:
        """True when the node was born and has not died since."""
        return self.life is not None

    def topic(self, kind: str, device: str | None = None) -> str:
        """Return the topic of a message of this node."""
        return f"{NAMESPACE}/{self.group}/{kind}/{self.name}" + ("" if device is None else f"/{device}")

    # -- deaths -------------------------------------------------------------------------------------------

    def will(self) -> Will:
        """Return the will of the next CONNECT, with the next bdSeq (topics-nbirth-bdseq-increment)."""
        return Will(topic=self.topic("NDEATH"), payload=self._death((self.bd_seq + 1) % 256))

    def connect_sent(self) -> None:
        """Note that the CONNECT left: its bdSeq is used up."""
        self.bd_seq = (self.bd_seq + 1) % 256

    def death(self) -> Message:
        """Compose the NDEATH of this connection, with the will's QoS 1."""
        return Message(topic=self.topic("NDEATH"), payload=self._death(self.bd_seq), qos=1)

    @staticmethod
    def _death(bd_seq: int) -> bytes:
        # NDEATH has only bdSeq, and no sequence number (topics-ndeath-payload, topics-ndeath-seq).
        return encode([Metric(name=_BD_SEQ, datatype="Int64", value=bd_seq)], None)

    # -- births -------------------------------------------------------------------------------------------

    def births(self, life: Life | None = None) -> list[Message]:
        """Compose NBIRTH and every DBIRTH of a life, by default the present one, in the order of sending.

        NBIRTH has the sequence number 0, the will's bdSeq, and the rebirth control (topics-nbirth-seq-num,
        -bdseq-matching, -rebirth-metric).
        """
        life = life or self.life
        assert life is not None
        own = (
            Metric(name=_BD_SEQ, datatype="Int64", value=self.bd_seq),
            Metric(name=REBIRTH, datatype="Boolean", value=False),
        )
        self.seq = 255
        node = self.numbered("NBIRTH", None, [*own, *life.node.values()])
        return [node, *(self.numbered("DBIRTH", name, told.values()) for name, told in life.devices.items())]

    # -- data ---------------------------------------------------------------------------------------------

    def new_values(self, device: str | None, values: Sequence[tuple[str, Any]]) -> list[Metric]:
        """Return values for NDATA or DDATA with the datatypes of the birth (operational-behavior-data-publish-dbirth).

        Raises:
            AdapterError: not born, a metric was not declared or occurs twice, or a value does not fit.
        """
        told = self.living().metrics_of(device)
        metrics: dict[str, Metric] = {}
        for index, (name, value) in enumerate(values):
            if name not in told:
                message = "the birth did not declare this metric"
                raise AdapterError("illegal_address", message, outcome="not_sent", field=f"/metrics/{index}/name")
            if name in metrics:
                raise AdapterError("invalid_input", "a metric is there twice", field=f"/metrics/{index}/name")
            check_value(told[name].datatype, value, f"/metrics/{index}/value")
            metrics[name] = Metric(name=name, datatype=told[name].datatype, value=value)
        return list(metrics.values())

    def remember(self, device: str | None, metrics: Sequence[Metric]) -> None:
        """Keep delivered values for the next birth (operational-behavior-data-publish-dbirth-values)."""
        life = self.living()
        told = {**life.metrics_of(device), **{metric.name: metric for metric in metrics}}
        self.life = life.with_node(told) if device is None else life.with_device(device, told)

    def living(self) -> Life:
        """Return the present life.

        Raises:
            AdapterError: ``not_born``: the node has not been born.
        """
        if self.life is None:
            raise AdapterError("not_born", "the edge node has not been born; call publish_node_birth first")
        return self.life

    def numbered(self, kind: str, device: str | None, metrics: Any) -> Message:
        """Compose a message with the next number of the node's sequence (payloads-sequence-num-incrementing)."""
        self.seq = (self.seq + 1) % 256
        return Message(topic=self.topic(kind, device), payload=encode(metrics, self.seq))
