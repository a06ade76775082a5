"""Oracles on the journal of an MQTT broker.

Journal kinds are the control packets (MQTT 3.1.1 and 5, chapter 3), one entry for each packet and direction; payloads are
base64. The packets of the simulator's clients and of the kit are left out everywhere, see ``entries``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from ...core.finding import Finding
from ...wire.mqtt.packets import PacketType
from ...wire.mqtt.sparkplug import NAMESPACE, parse_topic
from ..journal import Entries, JournalEntry
from ..oracle import Witness, requests
from ..protocol import Declared
from ..session_oracle import SessionOracle
from .commands import asks_for_births, commands, is_sparkplug_command
from .entries import FirstPackets, MqttEntry, adapter_packets, delivered_again, describe, payload_of, shown
from .entries import messages as published
from .host_state import HostState, state_births
from .sparkplug_oracle import Births, SparkplugSequence, broken_rule, commanded_once, ddata_metric, reported

__all__ = [
    "Births",
    "HostState",
    "Publications",
    "Refused",
    "SparkplugSequence",
    "Subscriptions",
    "acknowledged",
    "broken_rule",
    "caught_up",
    "commanded_once",
    "ddata_metric",
    "delivered",
    "exchange",
    "never_commanded",
    "never_published",
    "no_command",
    "not_granted",
    "not_published",
    "not_reported",
    "not_subscribed",
    "published_once",
    "refusals",
    "reported",
    "session_stays_up",
    "state_births",
    "subscription_lost",
    "unsubscribed",
]

_WITNESS = Witness(noun="the broker", describe=describe)

_HIGHEST_QOS = 2
_TOPICS_KEPT = 1000
"""Topics of a session's own messages whose first packets are kept; those on which every plant listens for commands always are."""

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
            refused = [code for code in codes if code > _HIGHEST_QOS]
            problem = f"it answered with reason code {refused[0]:#04x}" if refused else f"it has granted QoS {codes[0]}"
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

    def ended(self, filter: str) -> list[Finding]:
        """Expect that the adapter is not subscribed to this filter on any connection that is still open."""
        if not any(code <= _HIGHEST_QOS for code in self._granted.get(filter, {}).values()):
            return []
        return [
            Finding(
                code="still_subscribed",
                message=f"the subscription to {filter!r} should have ended, the broker still has it",
                requirement="MQT-002",
                evidence=self._first.shown(),
            )
        ]


def unsubscribed(entries: Entries, filter: str) -> list[Finding]:
    """Expect that the adapter sent an UNSUBSCRIBE of this filter, and that the broker answered it."""
    answered = {entry["answers"] for entry in entries}
    asked = adapter_packets(entries, "UNSUBSCRIBE", "in")
    if any(
        packet["seq"] in answered and filter in [unwanted.get("filter") for unwanted in packet["filters"]]
        for packet in asked
    ):
        return []
    return [
        Finding(
            code="still_subscribed",
            message=f"the broker should have been asked to end {filter!r}, it answered no such UNSUBSCRIBE",
            requirement="MQT-002",
            evidence=shown(entries),
        )
    ]


def not_granted(entries: Entries, filter: str) -> list[Finding]:
    """Expect that the adapter has subscribed to this filter, whatever its QoS, since these entries began."""
    subscriptions = Subscriptions()
    for entry in entries:
        subscriptions.feed(entry)
    return subscriptions.granted(filter, qos=None)


class Publications(SessionOracle):
    """The publications of the adapter, by topic, and packets of it that cannot be distinguished from publications."""

    def __init__(self) -> None:
        self._malformed = FirstPackets()
        self._by_topic: dict[str, FirstPackets] = {}
        self._retained: dict[str, MqttEntry] = {}

    def feed(self, entry: JournalEntry) -> None:
        """Note a PUBLISH."""
        for packet in _packets([entry], "PUBLISH"):
            topic = packet.get("topic")
            if topic is None:
                self._malformed.add(packet)
            elif topic.startswith(f"{NAMESPACE}/STATE/") or asks_for_births(packet):
                # A host application says that it is there, and asks nodes what they are (tck-id-intro-sparkplug-host-state).
                continue
            elif topic in self._by_topic or len(self._by_topic) < _TOPICS_KEPT or commands(packet, {}):
                self._by_topic.setdefault(topic, FirstPackets()).add(packet)
                if packet.get("retain"):
                    self._retained.setdefault(topic, packet)

    def guarded(self, declared: Declared) -> list[Finding]:
        """Expect that nothing commanded the plant in the whole life of the session; what was retained elsewhere is remarkable."""
        found = FirstPackets()
        found.extend(self._malformed)
        for packets in self._by_topic.values():
            if commands(packets.first[0], declared):
                found.extend(packets)
        return [
            *_unexpected("PUBLISH", found, "WR-004"),
            *(
                Finding(
                    code="retained_own",
                    message=f"with writes disabled nothing should be retained, the adapter published {topic!r} so",
                    requirement="WR-004",
                    evidence=describe(packet),
                    strength="SHOULD",
                )
                for topic, packet in self._retained.items()
                if not commands(packet, declared)
            ),
        ]


class Refused(SessionOracle):
    """Messages and Sparkplug commands that the adapter has reported as failed: none of them may ever reach the broker."""

    def __init__(self) -> None:
        self._payloads: set[bytes] = set()
        self._commands: list[Mapping[str, Any]] = []
        self._faults: list[Finding] = []

    def never(self, payload: bytes) -> None:
        """Expect that these bytes are not published any more, on whatever topic."""
        self._payloads.add(payload)

    def feed(self, entry: JournalEntry) -> None:
        """Judge a PUBLISH."""
        for payload in [payload for payload in self._payloads if never_published([entry], payload)]:
            self._faults += never_published([entry], payload)
            self._payloads.discard(payload)
        for inputs in [inputs for inputs in self._commands if never_commanded([entry], inputs)]:
            self._faults += never_commanded([entry], inputs)
            self._commands.remove(inputs)

    def failed(self, inputs: Mapping[str, Any]) -> None:
        """Expect that the payload of a failed publication, or what a failed command asks for, never comes."""
        if isinstance(payload := inputs.get("payload"), str):
            self.never(payload.encode())
        # A switch, such as that for a rebirth, has few values, and will be asked for again.
        if "node" in inputs and any(not isinstance(metric["value"], bool) for metric in inputs["metrics"]):
            self._commands.append(inputs)

    def restarted(self) -> Refused:
        """Return itself: what was refused stays refused."""
        return self

    def renewed(self) -> Refused:
        """Return itself: an adapter may keep a message for the process that comes after it."""
        return self

    def take_faults(self) -> list[Finding]:
        """Return the messages that came nevertheless."""
        faults, self._faults = self._faults, []
        return faults


def caught_up(entries: Entries, during: Entries) -> bool:
    """Tell whether the adapter has read the messages that it was sent: on each connection the broker has answered a request since.

    Args:
        entries: of the journal.
        during: those of a call that began when the messages had been sent.
    """
    sent = {packet["connection"] for kind in ("PUBLISH", "BURST") for packet in adapter_packets(entries, kind, "out")}
    ended = {packet["connection"] for packet in adapter_packets(entries, "DISCONNECTED")}
    asked = {request["seq"]: request["connection"] for request in requests(during)}
    answered = {asked[entry["answers"]] for entry in during if entry["answers"] in asked}
    return bool(answered) and sent - ended <= answered


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


def delivered_qos(entries: Entries, *, topic: str, payload: bytes) -> int | None:
    """Return the highest QoS with which the broker delivered this message to the adapter; None where it did not."""
    messages = adapter_packets(entries, "PUBLISH", "out", None)
    return max((int(entry.get("qos", 0)) for entry in messages if _is(entry, topic, payload)), default=None)


def subscription_lost(entries: Entries, *, topic: str, payload: bytes, qos: int = 0) -> list[Finding]:
    """Expect that the broker delivered this message, because the adapter had subscribed before the broker was restarted.

    Args:
        qos: with which a message came before the restart.
    """
    found = delivered_qos(entries, topic=topic, payload=payload)
    if found is not None and found >= qos:
        return []
    said = (
        "the broker had nobody to send it to"
        if found is None
        else f"with QoS {qos} as before, the broker sent it with QoS {found}: the adapter has subscribed again with less"
    )
    return [
        Finding(
            code="subscription_lost",
            message=f"a message on {topic!r} should have reached the adapter, which had subscribed before the restart, {said}",
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
    declared: Declared = MappingProxyType({}),
    client_id: str | None = None,
) -> list[Finding]:
    """Expect that the adapter published these bytes on this topic in this manner (a QoS of None is any), exactly once, and
    nothing else that commands the plant. What it publishes of itself elsewhere is its own affair."""
    messages = [
        message
        for message in published(entries, client_id)
        if message["topic"] == topic or payload_of(message) == payload or commands(message, declared)
    ]
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
        told = delivered_again(entries, [message for message in messages if _is(message, topic, payload)])
        problem += f" ({told})" if told else ""
    return [
        Finding(
            code=code,
            message=f"the broker should have received {payload[:80]!r} on {topic!r} {wanted}, {problem}",
            requirement=requirement,
            evidence=shown(entries),
        )
    ]


_REFUSED = 0x80
"""Reason codes from here on refuse (MQTT 5, section 2.4)."""
_LAST_ANSWER = {1: "PUBACK", 2: "PUBCOMP"}


def acknowledged(entries: Entries, payload: bytes, *, received_ns: int) -> list[Finding]:
    """Expect that the broker had acknowledged the message with these bytes, if its QoS has an acknowledgement.

    Args:
        entries: since the request of the call.
        received_ns: monotonic; when the call was answered with success.
    """
    sent = [packet for packet in adapter_packets(entries, "PUBLISH", "in") if payload_of(packet) == payload]
    if not any(packet["qos"] for packet in sent):
        return []
    wanted = {(_LAST_ANSWER.get(packet["qos"]), packet["connection"], packet.get("packet_id")) for packet in sent}
    answers = [packet for packet in adapter_packets(entries, direction="out") if packet["t_ns"] <= received_ns]
    if any(
        (answer["kind"], answer["connection"], answer.get("packet_id")) in wanted
        and answer["reason_codes"][0] < _REFUSED
        for answer in answers
    ):
        return []
    done = "it had refused it" if refusals(entries) else "it had not"
    return [
        Finding(
            code="not_acknowledged",
            message=f"the broker should have acknowledged {payload[:80]!r} with QoS {sent[0]['qos']} before the reply says success, {done}",
            requirement="MQT-001",
            evidence=shown(entries),
        )
    ]


def refusals(entries: Entries) -> list[MqttEntry]:
    """Return the answers by which the broker refused a message (MQTT 5, sections 3.4.2.1 and 3.5.2.1)."""
    return [
        packet
        for packet in adapter_packets(entries, direction="out")
        if packet["kind"] in ("PUBACK", "PUBREC") and packet["reason_codes"][0] >= _REFUSED
    ]


def never_published(entries: Entries, payload: bytes, *, client_id: str | None = None) -> list[Finding]:
    """Expect that no message with these bytes reached the broker, on any topic."""
    found = [entry for entry in adapter_packets(entries, "PUBLISH", "in", client_id) if payload_of(entry) == payload]
    return _made_up_for(f"{payload[:80]!r}", found, entries)


def never_commanded(entries: Entries, inputs: Mapping[str, Any]) -> list[Finding]:
    """Expect that no Sparkplug command that asks for this reached its target.

    Args:
        inputs: of the operation that was reported as failed.
    """
    found = [entry for entry in adapter_packets(entries, "PUBLISH", "in") if is_sparkplug_command(entry, inputs)]
    return _made_up_for(f"a command to {found[0]['topic']}", found, entries) if found else []


def _made_up_for(what: str, found: Sequence[MqttEntry], entries: Entries) -> list[Finding]:
    if not found:
        return []
    message = f"{what} was not told as a success and should never have been published, the broker received it {len(found)} time(s)"
    return [Finding(code="made_up_for", message=message, requirement="WR-010", evidence=shown(entries))]


def no_command(entries: Entries, declared: Declared = MappingProxyType({})) -> list[Finding]:
    """Expect no message of the adapter on the topics on which the plant listens for commands."""
    return _WITNESS.nothing_changed(entries, requirement="WR-010", commands=lambda entry: commands(entry, declared))


def not_published(
    entries: Entries,
    payload: bytes,
    *,
    requirement: str = "ERR-006",
    declared: Declared = MappingProxyType({}),
) -> list[Finding]:
    """Expect no message with these bytes, no command, and no malformed PUBLISH."""
    found = FirstPackets()
    for packet in _packets(entries, "PUBLISH"):
        if packet["kind"] == "malformed" or payload_of(packet) == payload or commands(packet, declared):
            found.add(packet)
    return _unexpected("PUBLISH", found, requirement)


def not_reported(entries: Entries, device: str) -> list[Finding]:
    """Expect no Sparkplug message about this device of the adapter's edge node."""
    found = FirstPackets()
    for packet in adapter_packets(entries, "PUBLISH", "in"):
        topic = parse_topic(packet["topic"])
        if topic is not None and topic.device == device:
            found.add(packet)
    return _unexpected("PUBLISH", found, "WR-004")


def not_subscribed(entries: Entries, *filters: str) -> list[Finding]:
    """Expect no SUBSCRIBE to any of these filters, and no malformed one."""
    found = FirstPackets()
    for packet in _packets(entries, "SUBSCRIBE"):
        if packet["kind"] == "malformed" or any(wanted.get("filter") in filters for wanted in packet["filters"]):
            found.add(packet)
    return _unexpected("SUBSCRIBE", found, "ADR-007")


def _packets(entries: Entries, kind: str) -> list[MqttEntry]:
    return [
        entry
        for entry in adapter_packets(entries, None, "in")
        if entry["kind"] == kind or (entry["kind"] == "malformed" and _begun(entry) in (None, kind))
    ]


def _begun(malformed: MqttEntry) -> str | None:
    """Return the type that the first byte of a malformed packet says; None where none came, or one that is none."""
    first = bytes.fromhex(malformed.get("bytes", ""))[:1]
    kinds = {kind.value: kind.name for kind in PacketType}
    return kinds.get(first[0] >> 4) if first else None


def _unexpected(kind: str, packets: FirstPackets, requirement: str) -> list[Finding]:
    if not packets.count:
        return []
    return [
        Finding(
            code="unexpected_packet",
            message=f"the broker should have seen no {kind} from the adapter, it saw {packets.count}",
            requirement=requirement,
            evidence=packets.shown(),
        )
    ]


def session_stays_up(entries: Entries, client_id: str | None = None) -> list[Finding]:
    """Expect that the adapter's connection did not end, unless it was made for this one call and ended with DISCONNECT.

    A connection over which no packet came is none of MQTT's: whether there is a port to connect to may be tried in this way.
    """
    packets = adapter_packets(entries, client_id=client_id)
    made_now = {entry["connection"] for entry in packets if entry["kind"] == "CONNECTED"}
    spoke = {entry["connection"] for entry in packets if entry["kind"] not in ("CONNECTED", "DISCONNECTED")}
    # One that was made before, and has no name yet, has not said CONNECT either.
    named = {entry["connection"] for entry in packets if entry.get("client_id") is not None}
    met = {entry["connection"] for entry in packets}
    packets = [entry for entry in packets if entry["connection"] not in (made_now - spoke) | (met - spoke - named)]
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
