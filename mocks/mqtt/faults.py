"""The fault plan of the broker: which packet of a client is answered how, first match wins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .packets import Packet, Publish, Subscribe, Unsubscribe

__all__ = ["OWN_CLIENTS", "FaultPlan", "Rule"]

OWN_CLIENTS = "otmcp-mock-"
"""Client ids that begin so belong to the mock itself: only a rule that names them applies to them."""

_PACKETS = ("CONNECT", "PUBLISH", "PUBREC", "PUBREL", "SUBSCRIBE", "UNSUBSCRIBE", "PINGREQ")
_REFUSALS = range(0x80, 0x100)
_CODES = {
    "CONNECT": range(1, 0x100),
    "PUBLISH": _REFUSALS,
    "SUBSCRIBE": (0, 1, 2, *_REFUSALS),
    "UNSUBSCRIBE": _REFUSALS,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One rule: conditions (None matches everything), how often it applies, and what happens.

    Attributes:
        packet: name of the control packet received.
        topic: topic of a PUBLISH, or one of the filters of a SUBSCRIBE or UNSUBSCRIBE.
        times: applied at most this often, None without limit.
        no_answer: obey the packet, but do not answer it; a CONNECT is not obeyed either.
        delay_s: obey it and answer that many seconds later; a CONNECT is obeyed later.
        reason_code: refuse with this code and do not obey; a SUBSCRIBE with 0 to 2 is granted that QoS instead. 3.1.1
            cannot refuse a PUBLISH or UNSUBSCRIBE: they are acknowledged and not obeyed.
        close, reset: obey it, then close the connection, or reset it; a CONNECT is not obeyed.
    """

    packet: str
    client_id: str | None = None
    topic: str | None = None
    times: int | None = None
    no_answer: bool = False
    delay_s: float = 0.0
    reason_code: int | None = None
    close: bool = False
    reset: bool = False

    @classmethod
    def read(cls, source: Mapping[str, Any]) -> Rule:
        """A rule from the control channel: conditions at the top, what happens under ``action``.

        Raises:
            ValueError: an unknown name, or a code for a packet whose answer has none.
        """
        action = source.get("action")
        if not isinstance(action, Mapping) or len(action) != 1:
            raise ValueError("a fault rule needs one action, for instance {'action': {'no_answer': true}}")
        conditions = {name: value for name, value in source.items() if name != "action"}
        unknown = (conditions.keys() - {"packet", "client_id", "topic", "times"}) | (
            action.keys() - {"no_answer", "delay_s", "reason_code", "close", "reset"}
        )
        if unknown:
            raise ValueError(f"unknown member {min(unknown)!r} of a fault rule")
        if conditions.get("packet") not in _PACKETS:
            raise ValueError(f"a fault rule needs the name of a packet, one of {', '.join(_PACKETS)}")
        code = action.get("reason_code")
        if code is not None and code not in _CODES.get(conditions["packet"], ()):
            raise ValueError(f"reason_code {code!r} is no answer to {conditions['packet']}")
        return cls(**conditions, **action)

    def applies(self, packet: Packet, client_id: str) -> bool:
        """Whether the conditions hold."""
        if self.packet != packet.type.name:
            return False
        if self.client_id is None and client_id.startswith(OWN_CLIENTS):
            return False
        return self.client_id in (None, client_id) and (self.topic is None or self.topic in _topics(packet))

    @property
    def refuses(self) -> bool:
        """Whether the packet is not to be obeyed."""
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


class FaultPlan:
    """Rules in order, with a count of how often each was applied."""

    def __init__(self, rules: list[dict[str, Any]]) -> None:
        self._rules = [Rule.read(rule) for rule in rules]
        self.hits = [0] * len(self._rules)

    def match(self, packet: Packet, client_id: str) -> Rule | None:
        """The rule that applies to this packet, if any; counts it."""
        for index, rule in enumerate(self._rules):
            if rule.applies(packet, client_id) and (rule.times is None or self.hits[index] < rule.times):
                self.hits[index] += 1
                return rule
        return None
