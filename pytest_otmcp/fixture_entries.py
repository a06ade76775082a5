"""Journal entries as a test reads them: typed views of what the mock devices put on record. Pure.

A view never hides anything: ``fields`` is the entry as the device wrote it, whatever the attributes above it name.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["JournalEntry", "ModbusEntry", "MqttEntry", "OpcUaEntry"]

_MOCK_CLIENTS = "otmcp-mock-"


@dataclass(frozen=True, slots=True)
class JournalEntry:
    """One thing that reached a device, or that it sent.

    Attributes:
        fields: the entry as the device wrote it.
    """

    fields: Mapping[str, Any]

    @property
    def seq(self) -> int:
        """Number of the entry since the device was started."""
        return int(self.fields["seq"])

    @property
    def time_ns(self) -> int:
        """Monotonic time of the machine, in nanoseconds."""
        return int(self.fields["t_ns"])

    @property
    def connection(self) -> int:
        """Number of the connection; 0 for none."""
        return int(self.fields["connection"])

    @property
    def received(self) -> bool:
        """The device received it; otherwise it sent it."""
        return bool(self.fields["direction"] == "in")

    @property
    def kind(self) -> str:
        """What it is in the protocol's words, such as ``request``, ``PUBLISH`` or ``Write``."""
        return str(self.fields["kind"])

    @property
    def writes(self) -> bool:
        """Somebody asks the device to change: a write request, a service call that writes or calls a method. A message
        counts when a client other than the plant's own publishes it."""
        return self.received and bool(self.fields.get("state_changing"))

    def matches(self, wanted: Mapping[str, Any]) -> bool:
        """The entry has all these fields with these values."""
        return all(name in self.fields and self.fields[name] == value for name, value in wanted.items())


class ModbusEntry(JournalEntry):
    """A Modbus TCP request or response (``request``, ``response``), or what happened to a connection."""

    __slots__ = ()

    @property
    def unit(self) -> int | None:
        """Unit identifier."""
        return self.fields.get("unit")

    @property
    def function(self) -> int | None:
        """Function code, without the bit that marks an exception."""
        return self.fields.get("function")

    @property
    def address(self) -> int | None:
        """First address, from 0 as in the PDU."""
        return self.fields.get("address")

    @property
    def quantity(self) -> int | None:
        """Number of registers or bits."""
        return self.fields.get("quantity")

    @property
    def values(self) -> list[int] | None:
        """Registers or bits written by a request, or read by a response."""
        return self.fields.get("values")

    @property
    def exception(self) -> int | None:
        """Exception code of a response, or None."""
        return self.fields.get("exception")

    @property
    def pdu(self) -> bytes:
        """Function code and data, as on the wire."""
        return bytes.fromhex(self.fields.get("pdu", ""))


class MqttEntry(JournalEntry):
    """An MQTT control packet (``CONNECT``, ``PUBLISH`` …), or what happened to a connection."""

    __slots__ = ()

    @property
    def client_id(self) -> str | None:
        """Client identifier of the connection."""
        return self.fields.get("client_id")

    @property
    def topic(self) -> str | None:
        """Topic of a message."""
        return self.fields.get("topic")

    @property
    def payload(self) -> bytes:
        """Payload of a message."""
        return base64.b64decode(self.fields.get("payload") or "")

    @property
    def qos(self) -> int | None:
        """Quality of service of a message."""
        return self.fields.get("qos")

    @property
    def retain(self) -> bool:
        """The message is, or was, retained."""
        return bool(self.fields.get("retain"))

    @property
    def sparkplug(self) -> Mapping[str, Any] | None:
        """The decoded Sparkplug B payload, or None."""
        return self.fields.get("sparkplug")

    @property
    def filters(self) -> list[str]:
        """Topic filters of a SUBSCRIBE or UNSUBSCRIBE."""
        return [str(wanted["filter"]) for wanted in self.fields.get("filters") or []]

    @property
    def simulated(self) -> bool:
        """The plant's own doing: its edge node, or what the test itself has published with ``poke``."""
        return self.connection == 0 or str(self.client_id or "").startswith(_MOCK_CLIENTS)

    @property
    def writes(self) -> bool:
        """A message that a client other than the plant has published."""
        return self.kind == "PUBLISH" and self.received and not self.simulated


class OpcUaEntry(JournalEntry):
    """An OPC UA service call: the request (received), the answer (sent), or what happened to a connection."""

    __slots__ = ()

    @property
    def nodes(self) -> list[Any]:
        """What the service call is about: node ids, or for Read and Write mappings with ``node_id`` and more."""
        return list(self.fields.get("nodes") or [])

    @property
    def results(self) -> list[Any]:
        """What was answered, in the order of the request."""
        return list(self.fields.get("results") or [])

    @property
    def node_ids(self) -> list[str]:
        """Ids of the nodes that the service call is about."""
        return [str(node["node_id"] if isinstance(node, Mapping) else node) for node in self.nodes]
