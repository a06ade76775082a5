"""Journal entries of an MQTT broker: control packets (MQTT 3.1.1 and 5, chapter 3), one for each packet and direction."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any, TypedDict, cast

from ..journal import ADAPTER, Entries, JournalEntry

__all__ = [
    "Filter",
    "FirstPackets",
    "MqttEntry",
    "adapter_packets",
    "as_mqtt",
    "delivered_again",
    "describe",
    "messages",
    "payload_of",
    "shown",
]

_MOST_SHOWN = 10


class Filter(TypedDict, total=False):
    """A topic filter of a SUBSCRIBE or UNSUBSCRIBE."""

    filter: str
    qos: int


class MqttEntry(JournalEntry, total=False):
    """An entry whose kind is the name of a control packet, or ``BURST``: messages of the kit that were sent one after the other.

    Members:
        client_id: of the connection, or None before its CONNECT.
        topic, payload, qos, retain, dup: of a message; the payload in base64.
        filters: of SUBSCRIBE and UNSUBSCRIBE.
        reason_codes: of an answer, one for each item.
        packet_id: the identifier that ties an answer to its request.
        will: of a CONNECT: topic, payload, QoS and retain of the will message, or None.
        clean_start: of a CONNECT.
        will_sent: the broker published this message as a client's will.
        reason: why a connection ended, or why a packet is malformed.
        bytes: of a malformed packet: its beginning, in hexadecimal digits.
        count: of a BURST: how many messages were sent on this connection; of the kit's own, how many it published.
    """

    client_id: str | None
    topic: str
    payload: str
    qos: int
    retain: bool
    dup: bool
    filters: list[Filter]
    reason_codes: list[int]
    packet_id: int
    will: Mapping[str, object] | None
    clean_start: bool
    will_sent: bool
    reason: str
    bytes: str
    count: int


def as_mqtt(entry: JournalEntry) -> MqttEntry:
    """Return an entry of a broker's journal with its own type."""
    return cast(MqttEntry, entry)


def adapter_packets(
    entries: Entries, kind: str | None = None, direction: str | None = None, client_id: str | None = None
) -> list[MqttEntry]:
    """Return the entries of the adapter's connections, by kind and direction; ``client_id`` chooses one client.

    Entries of the simulated plant and of the kit are left out: the adapter has not caused them.
    """
    return [
        as_mqtt(entry)
        for entry in entries
        if entry["origin"] == ADAPTER
        and kind in (None, entry["kind"])
        and direction in (None, entry["direction"])
        and client_id in (None, as_mqtt(entry).get("client_id"))
    ]


def messages(entries: Entries, client_id: str | None = None) -> list[MqttEntry]:
    """Return the messages that the adapter published.

    What is delivered again over another connection, marked as DUP, is the same message (MQTT 3.1.1, sections 3.3.1.1 and 4.4).
    """
    found: list[MqttEntry] = []
    for packet in adapter_packets(entries, "PUBLISH", "in", client_id):
        if not any(_again(packet, earlier) for earlier in found):
            found.append(packet)
    return found


def _again(packet: MqttEntry, earlier: MqttEntry) -> bool:
    same = ("client_id", "packet_id", "topic", "payload", "qos")
    marked = bool(packet.get("dup")) and bool(packet.get("qos")) and packet["connection"] != earlier["connection"]
    return marked and all(packet.get(name) == earlier.get(name) for name in same)


_FIRST_ANSWERS = {1: "PUBACK", 2: "PUBREC"}


def delivered_again(entries: Entries, found: Entries) -> str:
    """Say of messages with the same payload why they are several, and not one that is delivered again.

    Args:
        entries: since the first was sent.
        found: the messages.
    """
    packets = [as_mqtt(entry) for entry in found]
    answer = _FIRST_ANSWERS.get(packets[0].get("qos", 0)) if len(packets) > 1 else None
    if answer is None:
        return ""
    first, marked = packets[0], sum(bool(packet.get("dup")) for packet in packets[1:])
    here = (answer, first["connection"], first.get("packet_id"))
    answers = adapter_packets(entries, direction="out")
    answered = here in [(packet["kind"], packet["connection"], packet.get("packet_id")) for packet in answers]
    mark = (
        f"{marked} of them with DUP, and each a message of its own to a broker" if marked else "none of them with DUP"
    )
    return f"with QoS {first['qos']}, {mark}; the broker had {'sent' if answered else 'withheld'} the {answer} of the first"


def payload_of(message: Mapping[str, Any]) -> bytes:
    """Return the payload of a PUBLISH or of a will."""
    return base64.b64decode(message.get("payload") or "")


class FirstPackets:
    """A count of packets, and the first of them for a finding's evidence.

    Attributes:
        count: number of packets.
        first: the first of them.
    """

    def __init__(self) -> None:
        self.count = 0
        self.first: list[MqttEntry] = []

    def add(self, packet: MqttEntry) -> None:
        """Count a packet."""
        self.count += 1
        if len(self.first) < _MOST_SHOWN:
            self.first.append(packet)

    def extend(self, others: FirstPackets) -> None:
        """Count other packets, too."""
        self.first += others.first[: _MOST_SHOWN - len(self.first)]
        self.count += others.count

    def shown(self) -> str:
        """Describe the first packets, and say how many more there are."""
        if not self.count:
            return "no packet"
        more = self.count - len(self.first)
        return "; ".join(map(describe, self.first)) + (f"; … {more} more" if more else "")


def shown(entries: Entries) -> str:
    """Describe the adapter's packets, for a finding's evidence."""
    packets = FirstPackets()
    for packet in adapter_packets(entries):
        packets.add(packet)
    return packets.shown()


def describe(entry: JournalEntry) -> str:
    """Describe a packet in a few words: ``<`` for a packet from a client, ``>`` for a packet to it."""
    packet = as_mqtt(entry)
    text = f"{'<' if packet['direction'] == 'in' else '>'} {packet['kind']}"
    if packet["kind"] == "PUBLISH":
        text += f" {packet['topic']!r} QoS {packet.get('qos')}{' retained' if packet.get('retain') else ''}"
        text += " DUP" if packet.get("dup") else ""
        text += f" {payload_of(packet)[:60]!r}"
    elif packet["kind"] == "BURST":
        text += f" {packet['topic']!r}, {packet.get('count')} messages"
    elif packet["kind"] in ("SUBSCRIBE", "UNSUBSCRIBE"):
        text += f" {[wanted.get('filter') for wanted in packet.get('filters') or []]}"
    elif packet.get("reason_codes"):
        text += f" {packet['reason_codes']}"
    elif packet.get("reason"):
        text += f" ({packet['reason']})"
    return text
