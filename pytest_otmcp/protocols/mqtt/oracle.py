"""Oracles on the journal of an MQTT broker.

Journal kinds are the control packets (MQTT 3.1.1 and 5, chapter 3), one entry for each packet and direction; payloads are
base64. The packets of the simulator's clients and of the kit are left out everywhere, see ``entries``.
"""

from __future__ import annotations

from ...core.finding import Finding
from ..journal import Entries, JournalEntry
from ..oracle import Witness
from ..session_oracle import SessionOracle
from .entries import FirstPackets, MqttEntry, adapter_packets, as_mqtt, describe, payload_of, shown
from .sparkplug_oracle import SparkplugSequence, ddata_metric

__all__ = [
    "Publications",
    "Refused",
    "SparkplugSequence",
    "Subscriptions",
    "ddata_metric",
    "delivered",
    "exchange",
    "never_published",
    "no_command",
    "no_packet",
    "published_once",
    "session_stays_up",
    "subscription_lost",
]

_WITNESS = Witness(noun="the broker", describe=describe)

_HIGHEST_QOS = 2
_COMMANDS = "control/"
"""Prefix of the topics on which the plant listens for commands. An adapter's messages on other topics command nothing."""


exchange = _WITNESS.answered


class Subscriptions(SessionOracle):
    """The topic filters to which the adapter is subscribed."""

    def __init__(self, client_id: str | None = None) -> None:
        self._client_id = client_id
        self._first = FirstPackets()
        self._waiting: dict[tuple[int, int], list[str]] = {}
        self._asked: set[tuple[str, ...]] = set()
        self._granted: dict[str, dict[int, int]] = {}

    def feed(self, entry: JournalEntry) -> None:
        """Note the filters that are asked for and those that are granted, for each connection that is open."""
        for packet in adapter_packets([entry], client_id=self._client_id):
            self._first.add(packet)
            connection = packet["connection"]
            key = (connection, packet.get("packet_id", 0))
            if packet["kind"] == "SUBSCRIBE" and packet["direction"] == "in":
                self._waiting[key] = [wanted["filter"] for wanted in packet["filters"]]
                self._asked.add(tuple(self._waiting[key]))
            elif packet["kind"] == "SUBACK" and packet["direction"] == "out":
                for wanted, code in zip(self._waiting.pop(key, []), packet["reason_codes"], strict=False):
                    self._granted.setdefault(wanted, {})[connection] = code
            elif packet["kind"] == "UNSUBSCRIBE":
                for unwanted in packet["filters"]:
                    self._granted.get(unwanted["filter"], {}).pop(connection, None)
            elif packet["kind"] == "DISCONNECTED":
                for connections in self._granted.values():
                    connections.pop(connection, None)
                self._waiting = {key: wanted for key, wanted in self._waiting.items() if key[0] != connection}

    def granted(self, filter: str, *, qos: int | None) -> list[Finding]:
        """Expect that the adapter is subscribed to this filter, with this QoS (None is any), on a connection that is still
        open."""
        codes = list(self._granted.get(filter, {}).values())
        if qos in codes or (qos is None and any(code <= _HIGHEST_QOS for code in codes)):
            return []
        if codes:
            problem = f"it answered with reason code {codes[0]:#04x}"
        elif self._asked:
            problem = f"it saw SUBSCRIBE for {sorted(map(list, self._asked))} without that being granted"
        else:
            problem = "it saw no SUBSCRIBE"
        wanted = f"{filter!r}{'' if qos is None else f' at QoS {qos}'}"
        return [
            Finding(
                code="not_subscribed",
                message=f"the broker should have granted {wanted}, {problem}",
                requirement="MQT-002",
                evidence=self._first.shown(),
            )
        ]


class Publications(SessionOracle):
    """The messages that the adapter published, and its malformed packets that may have been one."""

    def __init__(self) -> None:
        self._first = FirstPackets()

    def feed(self, entry: JournalEntry) -> None:
        """Count the entry if it is a PUBLISH."""
        for packet in _packets([entry], "PUBLISH", "in", None):
            self._first.add(packet)

    def none(self) -> list[Finding]:
        """Expect that nothing was published in the whole life of the session."""
        return _unexpected("PUBLISH", "in", self._first)


class Refused(SessionOracle):
    """Messages whose publication the adapter has reported as failed: none of them may ever reach the broker."""

    def __init__(self) -> None:
        self._payloads: set[bytes] = set()
        self._faults: list[Finding] = []

    def never(self, payload: bytes) -> None:
        """Expect that these bytes are not published any more, on whatever topic."""
        self._payloads.add(payload)

    def feed(self, entry: JournalEntry) -> None:
        """Judge a PUBLISH."""
        for payload in [payload for payload in self._payloads if never_published([entry], payload)]:
            self._faults += never_published([entry], payload)
            self._payloads.discard(payload)

    def restarted(self) -> Refused:
        """Return itself: what was refused stays refused."""
        return self

    def take_faults(self) -> list[Finding]:
        """Return the messages that came nevertheless."""
        faults, self._faults = self._faults, []
        return faults


def delivered(entries: Entries, *, topic: str, payload: bytes, client_id: str | None = None) -> list[Finding]:
    """Expect that the broker delivered this message to the adapter."""
    messages = adapter_packets(entries, "PUBLISH", "out", client_id)
    if any(_is(entry, topic, payload) for entry in messages):
        return []
    others = [entry["topic"] for entry in messages]
    return [
        Finding(
            code="not_delivered",
            message=f"a message on {topic!r} should have reached the adapter, "
            + (f"the broker sent it {others[:4]}" if others else "the broker had nobody to send it to"),
            requirement="MQT-004",
            evidence=shown(entries),
        )
    ]


def subscription_lost(entries: Entries, *, topic: str, payload: bytes) -> list[Finding]:
    """Expect that the broker delivered this message, because the adapter had subscribed before the broker was restarted."""
    if not delivered(entries, topic=topic, payload=payload):
        return []
    return [
        Finding(
            code="subscription_lost",
            message=f"a message on {topic!r} should have reached the adapter, which had subscribed before the restart, "
            "the broker had nobody to send it to",
            requirement="REC-004",
            evidence=shown(entries),
        )
    ]


def _is(entry: MqttEntry, topic: str, payload: bytes) -> bool:
    return bool(entry["topic"] == topic) and payload_of(entry) == payload


def published_once(
    entries: Entries,
    *,
    topic: str,
    payload: bytes,
    qos: int | None = 0,
    retain: bool = False,
    client_id: str | None = None,
) -> list[Finding]:
    """Expect that the adapter published these bytes on this topic with this QoS (None is any), once, and nothing else."""
    messages = adapter_packets(entries, "PUBLISH", "in", client_id)
    code, requirement = "not_published_once", "WR-003" if len(messages) > 1 else "MQT-001"
    if len(messages) == 1 and _is(messages[0], topic, payload):
        found = (messages[0].get("qos"), bool(messages[0].get("retain")))
        if found[1] == retain and qos in (None, found[0]):
            return []
        code, requirement = "published_otherwise", "MQT-003"
        wanted = ("" if qos is None else f"with QoS {qos} and ") + ("retained" if retain else "not retained")
        problem = f"it came with QoS {found[0]} {'and' if found[1] else 'and not'} retained"
    else:
        wanted = "once and nothing else"
        problem = f"it received {len(messages)} message(s)"
    return [
        Finding(
            code=code,
            message=f"the broker should have received {payload[:80]!r} on {topic!r} {wanted}, {problem}",
            requirement=requirement,
            evidence=shown(entries),
        )
    ]


def never_published(entries: Entries, payload: bytes, *, client_id: str | None = None) -> list[Finding]:
    """Expect that no message with these bytes reached the broker, on any topic."""
    found = [entry for entry in adapter_packets(entries, "PUBLISH", "in", client_id) if payload_of(entry) == payload]
    if not found:
        return []
    return [
        Finding(
            code="made_up_for",
            message=f"{payload[:80]!r} was reported as failed and should never have been published, the broker received it "
            f"{len(found)} time(s)",
            requirement="WR-010",
            evidence=shown(entries),
        )
    ]


def no_command(entries: Entries) -> list[Finding]:
    """Expect that no message of the adapter reached the topics on which the plant listens for commands."""
    return _WITNESS.nothing_changed(entries, requirement="WR-010", commands=_is_command)


def _is_command(entry: JournalEntry) -> bool:
    return as_mqtt(entry)["topic"].startswith(_COMMANDS)


def no_packet(entries: Entries, kind: str, *, direction: str = "in", client_id: str | None = None) -> list[Finding]:
    """Expect no packet of this kind, not even a malformed one."""
    found = FirstPackets()
    for packet in _packets(entries, kind, direction, client_id):
        found.add(packet)
    return _unexpected(kind, direction, found)


def _packets(entries: Entries, kind: str, direction: str, client_id: str | None) -> list[MqttEntry]:
    return [
        entry
        for entry in adapter_packets(entries, None, direction, client_id)
        if entry["kind"] == kind or (entry["kind"] == "malformed" and entry.get("packet") in (None, kind))
    ]


def _unexpected(kind: str, direction: str, packets: FirstPackets) -> list[Finding]:
    if not packets.count:
        return []
    who = "from" if direction == "in" else "to"
    return [
        Finding(
            code="unexpected_packet",
            message=f"the broker should have seen no {kind} {who} the adapter, it saw {packets.count}",
            requirement="ERR-006",
            evidence=packets.shown(),
        )
    ]


def session_stays_up(entries: Entries, client_id: str | None = None) -> list[Finding]:
    """Expect that the adapter's connection did not end, unless it was made for this one call and ended with DISCONNECT."""
    packets = adapter_packets(entries, client_id=client_id)
    made = {entry["connection"] for entry in packets if entry["kind"] == "CONNECT"}
    left = {entry["connection"] for entry in packets if entry["kind"] == "DISCONNECT" and entry["direction"] == "in"}
    broken = {entry["connection"] for entry in packets if entry["kind"] == "malformed"}
    ended = [
        entry
        for entry in packets
        if entry["kind"] in ("DISCONNECT", "DISCONNECTED", "malformed")
        and entry["connection"] not in (made & left) - broken
    ]
    if not ended:
        return []
    return [
        Finding(
            code="session_ended",
            message="the adapter's connection to the broker should have stayed up, it ended with "
            + " and ".join(dict.fromkeys(entry["kind"] for entry in ended)),
            requirement="ADR-006",
            evidence=shown(entries),
        )
    ]
