"""Oracles on the messages of a Sparkplug edge node: births, deaths, one sequence (Sparkplug 3.0, chapters 5 and 6).

Payloads are decoded here, from the journal's bytes; the decoder of the broker is not relied on. The ids ``tck-id-…`` name
assertions of the specification; the wording is not the specification's.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal

from ...core.finding import Finding
from ...core.strict_json import same_json
from ...wire.mqtt.sparkplug import (
    DATA_TYPES,
    NAMESPACE,
    Topic,
    decode_message,
    decode_payload,
    parse_topic,
    payload_times,
)
from ..journal import Entries, JournalEntry
from ..session_oracle import SessionOracle
from ..stamp import Stamp
from .commands import REBIRTH as _REBIRTH
from .commands import commands
from .entries import MqttEntry, adapter_packets, as_mqtt, payload_of, shown

__all__ = [
    "Births",
    "SparkplugSequence",
    "broken_rule",
    "commanded_once",
    "ddata_metric",
    "kept_or_executed",
    "reported",
    "stamps",
]

_BD_SEQ = "bdSeq"
_FLOAT, _DOUBLE, _BOOLEAN = (DATA_TYPES.index(name) for name in ("Float", "Double", "Boolean"))
_MOST_FINDINGS = 5
_BIRTHS_KEPT = 8
_COMMANDS = ("NCMD", "DCMD")

_SENT_S = 60.0
"""Seconds between the time of a payload and its arrival: "the date and time at which the message was published" (section 6.4.5)."""

_CAPTURED_S = 86_400.0
"""The same for the time of a metric, which is when its value was captured. A value may be older; what is much older is no time of today."""

# Data type and name of the metrics that a birth declared, by name and by alias.
Declared = dict[str | int, tuple[str, int | None]]


class Births(SessionOracle):
    """What the births of the adapter's devices declare, over the whole life of a session.

    Data may name a metric by its alias alone (tck-id-payloads-alias-data-cmd-requirement), however long ago the birth was.
    """

    def __init__(self) -> None:
        self._declared: dict[str, deque[tuple[int, Declared]]] = {}

    def feed(self, entry: JournalEntry) -> None:
        """Note a DBIRTH."""
        for packet, message in _messages([entry], None):
            if message.get("type") == "DBIRTH":
                births = self._declared.setdefault(str(message["device"]), deque(maxlen=_BIRTHS_KEPT))
                births.append((packet["seq"], _declared(message)))

    def declared(self, device: str, before: int) -> Declared:
        """Return what the device's last birth before this sequence number of the journal declares; nothing without one."""
        return next((declared for seq, declared in reversed(self._declared.get(device, ())) if seq < before), {})


def _device_messages(
    entries: Entries, kind: str, device: str, births: Births | None, client_id: str | None = None
) -> list[tuple[Mapping[str, Any], Declared]]:
    """Return the device's messages of this kind, and what does not decode, each with what the birth before it declares."""
    found: list[tuple[Mapping[str, Any], Declared]] = []
    declared: Declared | None = None
    for packet, message in _messages(entries, client_id):
        if declared is None:
            declared = {} if births is None else births.declared(device, packet["seq"])
        if "error" in message or (message["type"], message["device"]) == (kind, device):
            found.append((message, declared))
        if message.get("type") == "DBIRTH" and message["device"] == device:
            declared = _declared(message)
    return found


def ddata_metric(
    entries: Entries,
    *,
    device: str,
    name: str,
    value: float,
    births: Births | None = None,
    client_id: str | None = None,
) -> list[Finding]:
    """Expect that the adapter published one DDATA for the device, with this metric alone, as Float or Double.

    Args:
        births: those of the session before ``entries``, for metrics that are sent by alias only.
    """
    problem = _ddata_problem(_device_messages(entries, "DDATA", device, births, client_id), name, value)
    if problem is None:
        return []
    return [
        Finding(
            code="wrong_ddata",
            message=f"the broker should have received one DDATA of {device} with {name} = {value}, {problem}",
            requirement="SPB-001",
            evidence=shown(entries),
        )
    ]


def _ddata_problem(found: Sequence[tuple[Mapping[str, Any], Declared]], name: str, value: float) -> str | None:
    if broken := [message["error"] for message, _ in found if "error" in message]:
        return f"a payload does not decode: {broken[0]}"
    metrics = [metric for message, _ in found for metric in message["metrics"]]
    if len(found) != 1 or len(metrics) != 1:
        listed = ", ".join(f"{metric['name']}={metric['value']!r}" for metric in metrics)
        return f"it received {len(found)} with {listed or 'no metric'}"
    metric, declared = metrics[0], found[0][1]
    label, datatype = metric["name"], metric["datatype"]
    if label is None and metric["alias"] in declared:
        label, datatype = declared[metric["alias"]][0], datatype or declared[metric["alias"]][1]
    if label != name:
        return f"its metric is {label!r}"
    # tck-id-payloads-metric-datatype-not-req: data messages need not repeat the type.
    if datatype not in (None, 0, _FLOAT, _DOUBLE):
        return f"its datatype is {_type_name(datatype)}"
    if metric["value"] is None:
        return "its metric is null" if metric["is_null"] else "its metric has no value"
    if isinstance(metric["value"], bool | str | list | dict):
        return f"its value is {metric['value']!r}"
    single = struct.unpack("<f", struct.pack("<f", value))[0]
    if metric["value"] != value and (datatype == _DOUBLE or metric["value"] != single):
        return f"its value is {metric['value']!r}"
    return None


def broken_rule(
    requirement: str, message: str, entries: Entries = (), *, strength: Literal["MUST", "SHOULD"] = "MUST"
) -> Finding:
    """Return the finding for a rule of Sparkplug that several packets together have broken.

    Args:
        entries: what is shown of the journal.
    """
    evidence = shown(entries) if entries else None
    return Finding(code="sparkplug", message=message, requirement=requirement, evidence=evidence, strength=strength)


def reported(
    entries: Entries,
    *,
    kind: str,
    device: str,
    metrics: Sequence[Mapping[str, Any]],
    births: Births,
    requirement: str = "SPB-001",
) -> list[Finding]:
    """Expect that the adapter published metrics of a device, each with the type and the value that were asked for.

    Args:
        kind: ``DBIRTH`` or ``DDATA``; births may be repeated, then the last one counts.
        metrics: each with ``name``, ``datatype`` and ``value``; None is null.
        births: those of the session before ``entries``, for metrics that are sent by alias only.
    """
    problem = _report_problem(_device_messages(entries, kind, device, births), kind, metrics)
    if problem is None:
        return []
    return [
        Finding(
            code="wrong_ddata",
            message=f"the broker should have received one {kind} of {device} with the metrics that were asked for, {problem}",
            requirement=requirement,
            evidence=shown(entries),
        )
    ]


def _report_problem(
    found: Sequence[tuple[Mapping[str, Any], Declared]], kind: str, metrics: Sequence[Mapping[str, Any]]
) -> str | None:
    if broken := [message["error"] for message, _ in found if "error" in message]:
        return f"a payload does not decode: {broken[0]}"
    if not found or (kind == "DDATA" and len(found) > 1):
        return f"it received {len(found)}"
    last, declared = found[-1]
    sent = {metric["name"] or declared.get(metric["alias"], (None, None))[0]: metric for metric in last["metrics"]}
    for wanted in metrics:
        metric = sent.get(wanted["name"])
        if metric is None:
            return f"it has no {wanted['name']}"
        # tck-id-payloads-metric-datatype-req: births have the type of every metric.
        if kind == "DBIRTH" and not metric["datatype"]:
            return f"{wanted['name']} has no data type"
        if (problem := _metric_problem(metric, wanted)) is not None:
            return problem
        if wanted["value"] is None and not metric["is_null"]:
            return f"{wanted['name']} should be null, it has no value and is not marked so"
    return None


def commanded_once(
    entries: Entries,
    *,
    group: str,
    node: str,
    device: str | None,
    metrics: Sequence[Mapping[str, Any]],
    aliases: Mapping[int, str] = MappingProxyType({}),
    client_id: str | None = None,
) -> list[Finding]:
    """Expect that the adapter published one command, an NCMD to this node or a DCMD to this device of it, with these metrics.

    Args:
        metrics: each with ``name``, ``datatype`` and ``value``.
        aliases: the names of metrics by the aliases of the target's birth, for a command that has no names.
    """
    # Births that a host asks for by itself are none of a call's.
    asks_for_births = any(metric["name"] == _REBIRTH for metric in metrics)
    found = [
        (entry, message)
        for entry, message in _messages(entries, client_id)
        if "error" in message or (message["type"] in _COMMANDS and (asks_for_births or commands(entry, {})))
    ]
    problem = _command_problem(found, (group, node, device), metrics, aliases)
    if problem is None:
        return []
    kind = "NCMD" if device is None else "DCMD"
    target = "/".join(part for part in (group, node, device) if part is not None)
    return [
        Finding(
            code="wrong_command",
            message=f"the broker should have received one {kind} to {target} with "
            f"{', '.join(str(metric['name']) for metric in metrics)}, {problem}",
            requirement="WR-003" if len(found) > 1 else "SPB-010",
            evidence=shown(entries),
        )
    ]


def _command_problem(
    found: Sequence[tuple[MqttEntry, Mapping[str, Any]]],
    target: tuple[str, str, str | None],
    metrics: Sequence[Mapping[str, Any]],
    aliases: Mapping[int, str],
) -> str | None:
    if broken := [message["error"] for _, message in found if "error" in message]:
        return f"a payload does not decode: {broken[0]}"
    if len(found) != 1:
        return f"it received {len(found)}"
    ((entry, message),) = found
    if (message["group"], message["edge_node"], message["device"]) != target:
        return f"it came on {entry['topic']}"
    # tck-id-topics-ncmd-mqtt, tck-id-topics-dcmd-mqtt: QoS 0, not retained; tck-id-payloads-ncmd-seq: no sequence number.
    if entry.get("qos") or entry.get("retain"):
        return f"it came with QoS {entry.get('qos')}{' and retained' if entry.get('retain') else ''}"
    if message["seq"] is not None:
        return f"it has the sequence number {message['seq']}"
    named = [(metric["name"] or aliases.get(metric["alias"]), metric) for metric in message["metrics"]]
    if sorted(str(name) for name, _ in named) != sorted(metric["name"] for metric in metrics):
        return f"its metrics are {[name for name, _ in named]}"
    by_name = dict(named)
    return next((problem for wanted in metrics if (problem := _metric_problem(by_name[wanted["name"]], wanted))), None)


def _metric_problem(sent: Mapping[str, Any], wanted: Mapping[str, Any]) -> str | None:
    # tck-id-payloads-metric-datatype-not-req: commands need not repeat the type.
    if sent["datatype"] not in (None, 0) and _type_name(sent["datatype"]) != wanted["datatype"]:
        return f"{wanted['name']} has the datatype {_type_name(sent['datatype'])}"
    value = wanted["value"]
    right = [value]
    if wanted["datatype"] in ("Float", "Double") and isinstance(value, int | float):
        right = [struct.unpack("<f", struct.pack("<f", value))[0] if wanted["datatype"] == "Float" else float(value)]
    elif sent["datatype"] in (None, 0) and isinstance(value, int) and value < 0:
        # Without its type a negative number is read as the two's complement that is on the wire.
        right = [value % 2**32, value % 2**64]
    if any(same_json(sent["value"], one) for one in right):
        return None
    return f"{wanted['name']} is {sent['value']!r}"


def _type_name(datatype: int | None) -> str:
    return DATA_TYPES[datatype] if datatype is not None and datatype < len(DATA_TYPES) else str(datatype)


def _messages(entries: Entries, client_id: str | None) -> Iterator[tuple[MqttEntry, Mapping[str, object]]]:
    for entry in adapter_packets(entries, "PUBLISH", "in", client_id):
        if (message := _message(entry)) is not None:
            yield entry, message


def _message(entry: MqttEntry) -> Mapping[str, object] | None:
    """Decode a PUBLISH as a Sparkplug message; None when it is no such message."""
    # The broker publishes a will on the client's behalf.
    if not str(entry.get("topic")).startswith(NAMESPACE + "/") or entry.get("will_sent"):
        return None
    message: Mapping[str, Any] | None = decode_message(entry["topic"], payload_of(entry))
    if message is None and not entry["topic"].startswith(f"{NAMESPACE}/STATE/"):
        return {"error": "the topic is not spBv1.0/group/type/edge_node[/device]"}
    return message


def stamps(entries: Entries) -> Iterator[Stamp]:
    """Yield the times of the adapter's Sparkplug messages and of their metrics; metrics that are marked as historical have none."""
    for packet, message in _messages(entries, None):
        if "error" in message:
            continue
        of = f"{message['type']} to {packet['topic']}"
        whole, metrics = payload_times(payload_of(packet))
        times = [(of, whole, _SENT_S), *((f"{name} in {of}", ms, _CAPTURED_S) for name, ms in metrics.items())]
        for what, ms, oldest_s in times:
            if ms is not None:
                yield Stamp(of=what, ms=ms, seen_ns=packet["t_ns"], oldest_s=oldest_s, requirement="SPB-001")


def _declared(message: Mapping[str, Any]) -> Declared:
    declared: Declared = {}
    for metric in message["metrics"]:
        if metric["name"] is not None:
            for key in (metric["name"], metric["alias"]):
                if key is not None:
                    declared[key] = (metric["name"], metric["datatype"])
    return declared


def kept_or_executed(request: JournalEntry, answer: JournalEntry | None) -> bool:
    """Tell whether a PUBLISH changed what the broker or the edge node behind it holds: it was retained, or is a command."""
    message = as_mqtt(request)
    topic = parse_topic(message["topic"])
    return bool(message.get("retain")) or (topic is not None and topic.type in ("NCMD", "DCMD"))


class SparkplugSequence(SessionOracle):
    """Oracle that expects each of the adapter's connections to keep the rules of an edge node.

    The rules: will with NDEATH and bdSeq, bdSeq counted from connection to connection, NBIRTH first, DBIRTH before DDATA,
    one sequence number for all, QoS 0, not retained, data only of metrics that a birth declared. An adapter that publishes
    as an edge node without its own birth impersonates that node; the same rules find it. A connection whose CONNECT was
    not seen is not judged.

    Args:
        group, edge_node: judge only this edge node; None for all.
        client_id: judge only this client; None for all.

    Attributes:
        findings: the first few faults.
    """

    def __init__(self, group: str | None = None, edge_node: str | None = None, client_id: str | None = None) -> None:
        self._node = (group, edge_node)
        self._client_id = client_id
        self._connections: dict[int, _Session] = {}
        self._unheard: set[int] = set()
        self._deaths: dict[str, int] = {}
        self._uncertain: set[str] = set()
        self._taken = 0
        self.findings: list[Finding] = []

    def restarted(self) -> SparkplugSequence:
        """Return the oracle for the connections after a restart of the broker: bdSeq goes on being counted."""
        following = SparkplugSequence(*self._node, self._client_id)
        following._deaths = dict(self._deaths)
        following._uncertain = set(self._deaths)
        return following

    def take_faults(self) -> list[Finding]:
        """Return the faults that have not been returned yet."""
        faults = self.findings[self._taken :]
        self._taken = len(self.findings)
        return faults

    def feed(self, entry: JournalEntry) -> None:
        """Judge the next packet by the packets that the connection sent before it."""
        for packet in adapter_packets([entry], client_id=self._client_id):
            room = _MOST_FINDINGS - len(self.findings)
            self.findings += list(self._check(packet))[:room]

    def _check(self, packet: MqttEntry) -> Iterator[Finding]:
        connection = packet["connection"]
        if packet["kind"] == "CONNECTED":
            self._unheard.add(connection)
        elif packet["kind"] == "DISCONNECTED":
            self._connections.pop(connection, None)
            if connection in self._unheard:
                # A reset discards what the broker has not read: that may have been a CONNECT, too.
                self._unheard.discard(connection)
                self._uncertain.update(self._deaths)
        elif packet["kind"] == "lost":
            # What the network has swallowed may have been a CONNECT, which counts.
            self._uncertain.update(self._deaths)
        elif packet["direction"] != "in":
            return
        elif packet["kind"] == "CONNECT":
            self._unheard.discard(connection)
            if self._unheard:
                # Its end is not known yet.
                self._uncertain.update(self._deaths)
            self._connections[connection] = session = _Session(packet)
            yield from session.check_count(self._deaths, self._uncertain)
        elif packet["kind"] == "PUBLISH" and connection in self._connections:
            message = _message(packet)
            if message is None:
                return
            topic = parse_topic(packet["topic"])
            group, edge_node = self._node
            if topic is None or (group in (None, topic.group) and edge_node in (None, topic.edge_node)):
                yield from self._connections[connection].check(packet, topic, message)


class _Session:
    """One MQTT connection: the edge nodes that publish through it."""

    def __init__(self, connect: MqttEntry) -> None:
        self.will: Mapping[str, Any] = connect.get("will") or {}
        self.death: Mapping[str, Any] = {"metrics": [], "seq": None}
        self.will_fault: str | None = None
        if self.will:
            try:
                self.death = decode_payload(payload_of(self.will))
            except ValueError as error:
                self.will_fault = str(error)
        self._clean = connect.get("clean_start", True)
        self._nodes: dict[tuple[str, str], _EdgeNode] = {}

    @property
    def bd_seq(self) -> object:
        """The will's bdSeq, or None."""
        return next((metric["value"] for metric in self.death["metrics"] if metric["name"] == _BD_SEQ), None)

    def check_count(self, deaths: dict[str, int], uncertain: set[str]) -> Iterator[Finding]:
        """Check that bdSeq is one more than at the connection before, modulo 256 (tck-id-topics-nbirth-bdseq-increment).

        Args:
            deaths: bdSeq of the last will, by its topic.
            uncertain: topics whose last will may have been a later one, which went down with the broker or was lost on the way.
        """
        topic = self.will.get("topic")
        if not isinstance(topic, str) or "/NDEATH/" not in topic or not isinstance(self.bd_seq, int):
            return
        last = deaths.get(topic)
        expected = self.bd_seq if last is None else (last + 1) % 256
        if topic in uncertain:
            uncertain.discard(topic)
            counted = self.bd_seq != last
        else:
            counted = self.bd_seq == expected
        if not counted:
            text = f"bdSeq of the will must be {expected} after {deaths[topic]}, it is {self.bd_seq}"
            yield _rule("SPB-006", text, topic)
        deaths[topic] = self.bd_seq

    def check(self, entry: MqttEntry, topic: Topic | None, message: Mapping[str, object]) -> Iterator[Finding]:
        if topic is None or "error" in message:
            yield _rule("SPB-001", f"the payload does not decode: {message['error']}", entry)
            return
        if topic.type in ("NCMD", "DCMD"):
            yield from _command(entry, topic, message)
            return
        key = (topic.group, topic.edge_node)
        if key not in self._nodes:
            self._nodes[key] = _EdgeNode()
        yield from self._nodes[key].check(entry, topic, message)
        if topic.type == "NBIRTH":
            yield from self._check_will(entry, topic, message)

    def _check_will(self, entry: MqttEntry, topic: Topic, message: Mapping[str, Any]) -> Iterator[Finding]:
        if not self.will:
            yield _rule("SPB-006", "CONNECT must carry the NDEATH as its will, it carries none", entry)
            return
        expected = f"{NAMESPACE}/{topic.group}/NDEATH/{topic.edge_node}"
        if self.will.get("topic") != expected or self.will.get("qos") != 1 or self.will.get("retain"):
            text = f"the will must go to {expected} with QoS 1, not retained; it goes to {self.will.get('topic')!r}"
            yield _rule("SPB-006", f"{text} with QoS {self.will.get('qos')}", entry)
        if self.will_fault is not None:
            yield _rule("SPB-006", f"the will's payload does not decode: {self.will_fault}", entry)
            return
        names = [metric["name"] for metric in self.death["metrics"]]
        if names != [_BD_SEQ] or self.death["seq"] is not None:
            yield _rule("SPB-006", f"the will must hold bdSeq alone and no seq, it holds {names}", entry)
        born = next((metric["value"] for metric in message["metrics"] if metric["name"] == _BD_SEQ), None)
        if None not in (self.bd_seq, born) and born != self.bd_seq:
            yield _rule("SPB-006", f"bdSeq of NBIRTH must be the will's {self.bd_seq}, it is {born}", entry)
        if not self._clean:
            yield _rule("SPB-006", "the connection must begin with a clean session", entry)


def _command(entry: MqttEntry, topic: Topic, message: Mapping[str, object]) -> Iterator[Finding]:
    if message["seq"] is not None:
        yield _rule("SPB-010", f"{topic.type} must carry no seq, it carries {message['seq']}", entry)
    if entry["qos"] != 0 or entry["retain"]:
        yield _rule("SPB-002", f"{topic.type} must have QoS 0 and not be retained", entry)


class _EdgeNode:
    """The state of one edge node as a host would know it."""

    def __init__(self) -> None:
        self._seq: int | None = None
        self._declared: dict[str | None, Declared] = {}

    def check(self, entry: MqttEntry, topic: Topic, message: Mapping[str, object]) -> Iterator[Finding]:
        kind, device = topic.type, topic.device
        if kind == "NDEATH":
            self._seq, self._declared = None, {}
            return
        if entry["qos"] != 0 or entry["retain"]:
            yield _rule("SPB-002", f"{kind} must have QoS 0 and not be retained", entry)
        if message["timestamp"] is None:
            yield _rule("SPB-001", f"{kind} must carry a timestamp", entry)
        yield from self._sequence(entry, kind, message["seq"])
        if kind in ("NBIRTH", "DBIRTH"):
            yield from self._birth(entry, topic, message)
        elif device is not None and device not in self._declared:
            yield _rule("SPB-003", f"{kind} of {device!r} before its DBIRTH", entry)
        elif kind == "DDEATH":
            del self._declared[device]
        elif device in self._declared:
            yield from self._data(entry, kind, message, self._declared[device])

    def _sequence(self, entry: MqttEntry, kind: str, seq: Any) -> Iterator[Finding]:
        if kind == "NBIRTH":
            # The specification says both "0" and "0 to 255" about the first number; the wider rule is applied.
            if seq is None or not 0 <= seq <= 255:
                yield _rule("SPB-004", f"NBIRTH must have a seq from 0 to 255, it has {seq}", entry)
        elif self._seq is None:
            yield _rule("SPB-003", f"{kind} before NBIRTH", entry)
        elif seq != (self._seq + 1) % 256:
            yield _rule("SPB-004", f"{kind} must have seq {(self._seq + 1) % 256}, it has {seq}", entry)
        self._seq = seq

    def _birth(self, entry: MqttEntry, topic: Topic, message: Mapping[str, Any]) -> Iterator[Finding]:
        if topic.type == "NBIRTH":
            # After a node's birth the earlier births of its devices are no longer valid.
            self._declared = {}
            metrics = {metric["name"]: metric for metric in message["metrics"]}
            if _BD_SEQ not in metrics:
                yield _rule("SPB-006", "NBIRTH must hold the metric bdSeq", entry)
            rebirth = metrics.get(_REBIRTH, {})
            if rebirth.get("value") is not False or rebirth.get("datatype") != _BOOLEAN:
                yield _rule("SPB-006", f"NBIRTH must declare {_REBIRTH} as Boolean false", entry)
        for metric in message["metrics"]:
            label = metric["name"] if metric["name"] is not None else f"alias {metric['alias']}"
            if metric["name"] is None or not metric["datatype"]:
                yield _rule("SPB-001", f"{topic.type}: {label} must have a name and a data type", entry)
            if metric["value"] is None and not metric["is_null"]:
                yield _rule("SPB-001", f"{topic.type}: {label} has neither a value nor is_null", entry)
        self._declared[topic.device] = _declared(message)

    def _data(self, entry: MqttEntry, kind: str, message: Mapping[str, Any], declared: Declared) -> Iterator[Finding]:
        for metric in message["metrics"]:
            key = metric["name"] if metric["name"] is not None else metric["alias"]
            if key not in declared:
                yield _rule("SPB-009", f"{kind} with the undeclared metric {key!r}", entry)
            elif metric["datatype"] not in (None, 0, declared[key][1]):
                born, sent = _type_name(declared[key][1]), _type_name(metric["datatype"])
                yield _rule("SPB-009", f"{kind}: {key!r} was born as {born} and is sent as {sent}", entry)


def _rule(requirement: str, message: str, where: MqttEntry | str) -> Finding:
    """Return the finding for a broken rule, seen in a packet or in a message to a topic."""
    topic, packet = (where, None) if isinstance(where, str) else (where["topic"], where["seq"])
    return Finding(
        code="sparkplug",
        message=f"{topic}: {message}",
        requirement=requirement,
        evidence=None if packet is None else f"packet {packet} of the journal",
    )
