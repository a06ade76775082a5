"""The oracle on the STATE of a Sparkplug host application: its birth and its death, by which edge nodes know whether anybody listens.

Sparkplug 3.0, sections 5.3 and 6.4.27; the ids ``tck-id-…`` name assertions of the specification. An adapter that publishes no STATE is
not judged.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from ...core.finding import Finding
from ...wire.mqtt.sparkplug import NAMESPACE
from ..journal import Entries, JournalEntry
from ..session_oracle import SessionOracle
from .entries import MqttEntry, adapter_packets, payload_of
from .filters import covers

__all__ = ["HostState", "state_births"]

_MOST_FINDINGS = 5
_QOS = 1


@dataclass(slots=True)
class _Connection:
    """What a connection has said: its will, if that is a STATE, the filters that it asked for, and whether it has been born."""

    will: Mapping[str, Any]
    filters: list[str] = field(default_factory=list)
    born: bool = False


class HostState(SessionOracle):
    """Oracle that expects of a STATE that it has the form that nodes read, and that of each connection belongs to its will.

    Attributes:
        topic: of the STATE that the adapter published last; None as long as it has published none.
    """

    def __init__(self) -> None:
        self.topic: str | None = None
        self._connections: dict[int, _Connection] = {}
        self._found: list[Finding] = []
        self._taken = 0

    def renewed(self) -> HostState:
        """Return the oracle of the next session: an adapter that publishes its STATE publishes it in each."""
        following = HostState()
        following.topic = self.topic
        return following

    def restarted(self) -> HostState:
        """Return the same after a restart of the broker."""
        return self.renewed()

    def take_faults(self) -> list[Finding]:
        """Return the faults that have not been returned yet."""
        faults = self._found[self._taken :]
        self._taken = len(self._found)
        return faults

    def feed(self, entry: JournalEntry) -> None:
        """Judge a CONNECT or a STATE."""
        for packet in adapter_packets([entry], direction="in"):
            room = _MOST_FINDINGS - len(self._found)
            self._found += list(self._check(packet))[:room]

    def _check(self, packet: MqttEntry) -> Iterator[Finding]:
        if packet["kind"] == "CONNECT":
            will = packet.get("will") or {}
            of_state = _is_state(str(will.get("topic")))
            self._connections[packet["connection"]] = _Connection(will if of_state else {})
            if of_state:
                yield from _form(packet, will, "the will")
                if _said(will).get("online") is not False:
                    yield _rule("the will must say that the host is not online", packet)
        elif packet["kind"] == "SUBSCRIBE" and packet["connection"] in self._connections:
            self._connections[packet["connection"]].filters += [one["filter"] for one in packet["filters"]]
        elif packet["kind"] == "PUBLISH" and _is_state(packet["topic"]) and not packet.get("will_sent"):
            self.topic = packet["topic"]
            yield from _form(packet, packet, "STATE")
            if _said(packet).get("online") is True:
                yield from self._birth(packet)

    def _birth(self, packet: MqttEntry) -> Iterator[Finding]:
        connection = self._connections.get(packet["connection"])
        # What is delivered again is no birth of this connection.
        if connection is None or connection.born or packet.get("dup"):
            # What is published again when another one has said otherwise may have a time of its own.
            return
        connection.born = True
        if connection.will.get("topic") != packet["topic"]:
            yield _rule("CONNECT must carry as its will that the host is not online, it carries no such will", packet)
        elif (told := _said(connection.will).get("timestamp")) != (own := _said(packet).get("timestamp")):
            yield _rule(f"STATE must have the timestamp of the will of its connection, {told}, it has {own}", packet)
        if not any(covers(wanted, packet["topic"]) for wanted in connection.filters):
            yield _rule("the host must have subscribed to its own STATE before it publishes that, it had not", packet)


def state_births(entries: Entries, topic: str) -> list[MqttEntry]:
    """Return the messages by which the adapter has this STATE say that it is online, as long as nothing else is said."""
    return [
        packet
        for packet in adapter_packets(entries, "PUBLISH", "in")
        if packet["topic"] == topic and packet.get("retain") and _said(packet).get("online") is True
    ]


def _is_state(topic: str) -> bool:
    """Tell whether a topic is spBv1.0/STATE/host (tck-id-host-topic-phid-birth-topic)."""
    namespace, _, rest = topic.partition("/")
    kind, _, host = rest.partition("/")
    return (namespace, kind) == (NAMESPACE, "STATE") and bool(host) and "/" not in host


def _said(message: Mapping[str, Any]) -> Mapping[str, Any]:
    try:
        content = json.loads(payload_of(message))
    except ValueError:
        return {}
    return content if isinstance(content, dict) else {}


def _form(packet: MqttEntry, message: Mapping[str, Any], what: str) -> Iterator[Finding]:
    said = _said(message)
    stamp = said.get("timestamp")
    if not isinstance(said.get("online"), bool) or isinstance(stamp, bool) or not isinstance(stamp, int):
        text = "must be JSON with 'online', true or false, and 'timestamp' in milliseconds"
        yield _rule(f"{what} {text}, it is {payload_of(message)[:80]!r}", packet)
    if message.get("qos") != _QOS or not message.get("retain"):
        kept = "retained" if message.get("retain") else "not retained"
        yield _rule(f"{what} must have QoS 1 and be retained, it has QoS {message.get('qos')} and is {kept}", packet)


def _rule(text: str, packet: MqttEntry) -> Finding:
    return Finding(
        code="sparkplug", message=text, requirement="SPB-013", evidence=f"packet {packet['seq']} of the journal"
    )
