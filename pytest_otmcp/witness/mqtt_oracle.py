"""What an MQTT broker witnesses.

Journal kinds are the control packets (MQTT 3.1.1, section 3), one entry a packet and direction; payloads are base64. A
PUBLISH below ``spBv1.0/`` also carries its Sparkplug payload, decoded with the official schema.

The simulator's own clients (``otmcp-mock-…``) and what the kit itself published (connection 0) are not the adapter's
doing and are left out everywhere.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ..findings import Finding

__all__ = [
    "ddata_metric",
    "delivered",
    "exchange",
    "no_packet",
    "published_once",
    "session_stays_up",
    "sparkplug_sequence",
    "subscribed",
]

Entry = Mapping[str, Any]
Entries = Sequence[Entry]

MOCK_CLIENTS = "otmcp-mock-"
_ANSWERS = {"CONNACK", "SUBACK", "UNSUBACK", "PINGRESP", "PUBACK", "PUBCOMP"}


def _adapter(entries: Entries, kind: str | None = None, direction: str | None = None) -> list[Entry]:
    return [
        entry
        for entry in entries
        if entry["connection"] != 0
        and not str(entry.get("client_id") or "").startswith(MOCK_CLIENTS)
        and kind in (None, entry["kind"])
        and direction in (None, entry["direction"])
    ]


def _seen(entries: Entries) -> str:
    packets = [
        f"{'<' if entry['direction'] == 'in' else '>'} {entry['kind']}"
        + (f" {entry['topic']!r} {_payload(entry)[:60]!r}" if entry["kind"] == "PUBLISH" else "")
        for entry in _adapter(entries)
    ]
    return "; ".join(packets[:10]) + (" …" if len(packets) > 10 else "") if packets else "no packet"


def _payload(entry: Entry) -> bytes:
    return base64.b64decode(entry.get("payload") or "")


def exchange(entries: Entries, at_least: int = 1) -> list[Finding]:
    """The broker answered the adapter at least that often."""
    answers = [entry for entry in _adapter(entries, direction="out") if entry["kind"] in _ANSWERS]
    if len(answers) >= at_least:
        return []
    return [
        Finding(
            code="no_exchange",
            message=f"the broker should have answered the adapter at least {at_least} time(s) during the call(s), "
            f"it answered {len(answers)} time(s)",
            requirement="RD-004",
            evidence=_seen(entries),
        )
    ]


def subscribed(entries: Entries, *, filter: str, qos: int) -> list[Finding]:
    """The broker received a SUBSCRIBE with this filter and granted this QoS."""
    requests = {
        (entry["connection"], entry["packet_id"]): [wanted["filter"] for wanted in entry["filters"]]
        for entry in _adapter(entries, "SUBSCRIBE", "in")
    }
    for answer in _adapter(entries, "SUBACK", "out"):
        filters = requests.get((answer["connection"], answer["packet_id"]), [])
        if filter in filters and answer["reason_codes"][filters.index(filter)] == qos:
            return []
    return [
        Finding(
            code="not_subscribed",
            message=f"the broker should have granted {filter!r} at QoS {qos}, it saw "
            + (f"SUBSCRIBE for {sorted(requests.values())}" if requests else "no SUBSCRIBE"),
            requirement="MQT-002",
            evidence=_seen(entries),
        )
    ]


def delivered(entries: Entries, *, topic: str, payload: bytes) -> list[Finding]:
    """The broker delivered this message to the adapter."""
    for entry in _adapter(entries, "PUBLISH", "out"):
        if entry["topic"] == topic and _payload(entry) == payload:
            return []
    return [
        Finding(
            code="not_delivered",
            message=f"a message on {topic!r} should have reached the adapter, the broker had nobody to send it to",
            requirement="MQT-004",
            evidence=_seen(entries),
        )
    ]


def published_once(entries: Entries, *, topic: str, payload: bytes) -> list[Finding]:
    """The adapter published these bytes on this topic, once, and nothing else."""
    messages = _adapter(entries, "PUBLISH", "in")
    if len(messages) == 1 and messages[0]["topic"] == topic and _payload(messages[0]) == payload:
        return []
    return [
        Finding(
            code="not_published_once",
            message=f"the broker should have received {payload[:80]!r} on {topic!r} once and nothing else, it received "
            f"{len(messages)} message(s)",
            requirement="WR-003" if len(messages) > 1 else "MQT-001",
            evidence=_seen(entries),
        )
    ]


def no_packet(entries: Entries, kind: str, *, direction: str) -> list[Finding]:
    """No packet of this kind."""
    packets = _adapter(entries, kind, direction)
    if not packets:
        return []
    return [
        Finding(
            code="unexpected_packet",
            message=f"the broker should have seen no {kind} from the adapter, it saw {len(packets)}",
            requirement="ERR-006",
            evidence=_seen(entries),
        )
    ]


def session_stays_up(entries: Entries) -> list[Finding]:
    """The adapter's connection did not end."""
    ended = [entry for entry in _adapter(entries) if entry["kind"] in ("DISCONNECT", "DISCONNECTED")]
    if not ended:
        return []
    return [
        Finding(
            code="session_ended",
            message="the adapter's connection to the broker should have stayed up, it ended",
            requirement="ADR-006",
            evidence=_seen(entries),
        )
    ]


def _sparkplug(entries: Entries) -> Iterator[tuple[Entry, Mapping[str, Any]]]:
    for entry in _adapter(entries, "PUBLISH", "in"):
        if entry["topic"].startswith("spBv1.0/"):
            yield entry, entry.get("sparkplug") or {"error": "not decoded"}


def ddata_metric(entries: Entries, *, device: str, name: str, value: float) -> list[Finding]:
    """The adapter published one DDATA for the device, with this metric alone, as Float or Double."""
    messages = [
        message for _, message in _sparkplug(entries) if message.get("type") == "DDATA" and message["device"] == device
    ]
    metrics = [metric for message in messages for metric in message["metrics"]]
    if len(messages) == 1 and len(metrics) == 1 and (metrics[0]["name"], metrics[0]["value"]) == (name, value):
        # A datatype may be left out of data messages (tck-id-payloads-metric-datatype-not-req): 9 Float, 10 Double.
        if metrics[0]["datatype"] in (None, 0, 9, 10):
            return []
        problem = f"its datatype is {metrics[0]['datatype']}"
    else:
        shown = [f"{metric['name']}={metric['value']!r}" for metric in metrics]
        problem = f"it received {len(messages)} with {', '.join(shown) or 'no metric'}"
    return [
        Finding(
            code="wrong_ddata",
            message=f"the broker should have received one DDATA of {device} with {name} = {value}, {problem}",
            requirement="SPB-001",
            evidence=_seen(entries),
        )
    ]


def sparkplug_sequence(entries: Entries) -> list[Finding]:
    """Each of the adapter's connections keeps the rules of an edge node (Sparkplug 3.0, chapters 5 and 6).

    Will with NDEATH and bdSeq, NBIRTH first, DBIRTH before DDATA, one sequence number for all, QoS 0, not retained,
    data only of metrics that a birth declared. ``entries`` must begin before the connections do.
    """
    findings: list[Finding] = []
    connections: dict[int, _EdgeNode] = {}
    for entry in _adapter(entries, "CONNECT", "in"):
        connections[entry["connection"]] = _EdgeNode(entry)
    for entry, message in _sparkplug(entries):
        node = connections.get(entry["connection"])
        if node is not None:
            findings += node.check(entry, message)
    return findings[:5]


class _EdgeNode:
    def __init__(self, connect: Entry) -> None:
        self._will = connect.get("will")
        self._seq: int | None = None
        self._declared: dict[str | None, set[str]] = {}

    def check(self, entry: Entry, message: Mapping[str, Any]) -> Iterator[Finding]:
        if "error" in message:
            yield _rule("SPB-001", f"{entry['topic']}: the payload does not decode: {message['error']}", entry)
            return
        kind, device = message["type"], message["device"]
        if kind in ("NCMD", "DCMD"):
            return
        if kind != "NDEATH" and (entry["qos"] != 0 or entry["retain"]):
            yield _rule("SPB-002", f"{kind} must have QoS 0 and not be retained", entry)
        if kind == "NBIRTH":
            yield from self._node_birth(entry, message)
        elif kind != "NDEATH":
            if self._seq is None:
                yield _rule("SPB-003", f"{kind} before NBIRTH", entry)
            elif message["seq"] != (self._seq + 1) % 256:
                yield _rule("SPB-004", f"{kind} has seq {message['seq']} after {self._seq}", entry)
            self._seq = message["seq"]
        names = {metric["name"] for metric in message["metrics"]}
        if kind == "DBIRTH":
            self._declared[device] = names
        elif kind == "DDATA" and device not in self._declared:
            yield _rule("SPB-003", f"DDATA of {device!r} before its DBIRTH", entry)
        elif kind == "DDATA" and not names <= self._declared[device]:
            yield _rule("SPB-009", f"DDATA with undeclared metrics {sorted(names - self._declared[device])}", entry)

    def _node_birth(self, entry: Entry, message: Mapping[str, Any]) -> Iterator[Finding]:
        self._seq = message["seq"]
        self._declared = {}
        metrics = {metric["name"]: metric["value"] for metric in message["metrics"]}
        if "bdSeq" not in metrics:
            yield _rule("SPB-006", "NBIRTH without the metric bdSeq", entry)
        if metrics.get("Node Control/Rebirth") is not False:
            yield _rule("SPB-006", "NBIRTH must declare Node Control/Rebirth as false", entry)
        will = self._will or {}
        declared = (will.get("sparkplug") or {}).get("metrics") or []
        death = {metric["name"]: metric["value"] for metric in declared}
        if "/NDEATH/" not in str(will.get("topic")) or will.get("qos") != 1 or will.get("retain"):
            yield _rule("SPB-006", "CONNECT must carry an NDEATH will with QoS 1, not retained", entry)
        elif set(death) != {"bdSeq"} or death["bdSeq"] != metrics.get("bdSeq"):
            yield _rule("SPB-006", "the will must hold the metric bdSeq alone, equal to NBIRTH's", entry)


def _rule(requirement: str, message: str, entry: Entry) -> Finding:
    return Finding(code="sparkplug", message=message, requirement=requirement, evidence=f"topic {entry['topic']}")
