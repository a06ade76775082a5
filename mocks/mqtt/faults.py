"""The fault plan of the broker: which packet of a client gets which fault."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pytest_otmcp.wire.mqtt.packets import Packet, Publish, Subscribe, Unsubscribe

from ..fault_plan import FaultRule, Plan
from ..fault_rules import FLAG, SKIP, TEXT, Table, integer, number, one_of
from ..network import MANNERS

__all__ = ["OWN_CLIENTS", "TABLE", "FaultPlan", "Rule"]

OWN_CLIENTS = "otmcp-mock-"
"""Client ids with this prefix belong to the mock itself: only a rule that names them applies to them."""

_PACKETS = ("CONNECT", "PUBLISH", "PUBREC", "PUBREL", "SUBSCRIBE", "UNSUBSCRIBE", "PINGREQ")
_REFUSALS = range(0x80, 0x100)
_CODES = {
    "CONNECT": range(1, 0x100),
    "PUBLISH": _REFUSALS,
    "SUBSCRIBE": (0, 1, 2, *_REFUSALS),
    "UNSUBSCRIBE": _REFUSALS,
}
TABLE = Table(
    conditions={"packet": one_of(*_PACKETS), "client_id": TEXT, "topic": TEXT, "skip": SKIP},
    actions={
        "no_answer": FLAG,
        "delay_s": number(0, 3600),
        "reason_code": integer(0, 0xFF),
        "close": FLAG,
        "reset": FLAG,
        "ack_only": FLAG,
        "disconnect": integer(0x80, 0xFF),
        **MANNERS,
    },
    example="{'no_answer': true}",
    required=("packet",),
    one_action=True,
    qualifiers=("drip_bytes",),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule(FaultRule):
    """One rule: conditions (None matches everything), how often it applies, and what happens beside what :class:`FaultRule` has.

    Attributes:
        packet: name of the control packet received.
        topic: topic of a PUBLISH, or one of the filters of a SUBSCRIBE or UNSUBSCRIBE.
        no_answer: handle the packet, but do not answer it; a CONNECT is not handled either.
        delay_s: handle it and answer this many seconds later; a CONNECT is handled later.
        reason_code: refuse with this code and do not handle it; a SUBSCRIBE with 0 to 2 is granted that QoS instead. A rule with
            a topic refuses that filter alone and handles the others of the same SUBSCRIBE. 3.1.1 cannot refuse a PUBLISH or
            UNSUBSCRIBE: they are acknowledged and not handled. Where 3.1.1 has a return code of its own for the reason, a
            CONNECT gets that.
        close, reset: handle it, then close the connection, or reset it; a CONNECT is not handled.
        ack_only: acknowledge a PUBLISH as delivered, and deliver it to nobody.
        disconnect: handle it; then, instead of an answer, an MQTT 5 client gets a DISCONNECT with this reason code and the
            connection is closed. 3.1.1 has no such packet: there the connection is closed.
    """

    packet: str
    client_id: str | None = None
    topic: str | None = None
    no_answer: bool = False
    delay_s: float = 0.0
    reason_code: int | None = None
    close: bool = False
    reset: bool = False
    ack_only: bool = False
    disconnect: int | None = None

    def applies(self, packet: Packet, client_id: str) -> bool:
        """Tell whether the conditions hold."""
        if self.packet != packet.type.name:
            return False
        if self.client_id is None and client_id.startswith(OWN_CLIENTS):
            return False
        return self.client_id in (None, client_id) and (self.topic is None or self.topic in _topics(packet))

    @property
    def refuses(self) -> bool:
        """Tell whether the packet is answered without being handled."""
        return self.reason_code is not None and (self.reason_code >= 0x80 or self.packet == "CONNECT")


def _topics(packet: Packet) -> tuple[str, ...]:
    match packet:
        case Publish():
            return (packet.topic,)
        case Subscribe():
            return tuple(request.filter for request in packet.requests)
        case Unsubscribe():
            return packet.filters
        case _:
            return ()


class FaultPlan(Plan[Rule]):
    """The plan that the rules of the control channel make."""

    table, rule = TABLE, Rule

    def match(self, packet: Packet, client_id: str) -> Rule | None:
        """Return the rule that applies to this packet, if any; count it."""
        return self.first(lambda rule: rule.applies(packet, client_id))

    def _read(self, source: Mapping[str, Any]) -> Rule:
        rule = super()._read(source)
        if rule.reason_code is not None and rule.reason_code not in _CODES.get(rule.packet, ()):
            raise ValueError(f"reason_code {rule.reason_code!r} is no answer to {rule.packet}")
        if rule.ack_only and rule.packet != "PUBLISH":
            raise ValueError(f"ack_only is about PUBLISH, not {rule.packet}")
        if rule.disconnect is not None and rule.packet == "CONNECT":
            raise ValueError("a CONNECT is refused with a reason_code, not with a DISCONNECT")
        return rule
