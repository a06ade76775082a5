"""The oracles of MQTT, on entries written by hand."""

from __future__ import annotations

import base64
from typing import Any

import pytest

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.mqtt import oracle
from pytest_otmcp.protocols.mqtt.entries import delivered_again

from ..feeding import fed
from .journals import Entry
from .journals import journal as contract


def b64(data: bytes) -> str:
    return base64.b64encode(data).decode()


# The kind of an answer to the kind of the request.
ANSWERS = {"PINGRESP": "PINGREQ", "SUBACK": "SUBSCRIBE"}


def journal(*packets: Entry) -> list[Entry]:
    """Return a broker's journal that says which packets are requests, and which packet answers which."""
    entries = contract(*packets, client_id="adapter")
    asked: dict[Any, int] = {}
    for entry in entries:
        key = (entry["connection"], ANSWERS.get(entry["kind"], entry["kind"]), entry.get("packet_id"))
        if entry["direction"] == "in":
            entry["request"] = entry["origin"] == "client" and entry["kind"] in ("PINGREQ", "SUBSCRIBE", "PUBLISH")
            entry["state_changing"] = entry["request"] and entry["kind"] == "PUBLISH"
            asked[key] = entry["seq"]
        elif entry["kind"] in ANSWERS:
            entry["answers"] = asked.pop(key, None)
    return entries


def publish(payload: bytes = b"50", **fields: Any) -> Entry:
    defaults = {"direction": "in", "kind": "PUBLISH", "topic": "control/pump", "qos": 0, "retain": False, "dup": False}
    return {**defaults, "packet_id": None, "payload": b64(payload), **fields}


def sent(kind: str, **fields: Any) -> Entry:
    return {"direction": "in", "kind": kind, **fields}


def answered(kind: str, **fields: Any) -> Entry:
    return {"direction": "out", "kind": kind, **fields}


MOCK: Entry = {"origin": "plant", "client_id": "otmcp-mock-edge-node-1", "connection": 9}
KIT: Entry = {"origin": "kit", "client_id": "otmcp-kit", "connection": 0}
SUBSCRIBED = (
    sent("SUBSCRIBE", packet_id=3, filters=[{"filter": "x", "qos": 0}, {"filter": "sensors/#", "qos": 1}]),
    answered("SUBACK", packet_id=3, reason_codes=[0x80, 1]),
)


def words(findings: list[Any]) -> str:
    (finding,) = findings
    return f"{finding.message} [{finding.requirement}] {finding.evidence or ''}"


def test_an_exchange_is_a_request_of_the_adapter_and_its_answer() -> None:
    ping = (sent("PINGREQ"), answered("PINGRESP"))
    assert oracle.exchange(journal(*ping)) == []
    assert oracle.exchange(journal(*SUBSCRIBED, *ping), at_least=2) == []
    for entries in (
        journal(sent("PINGREQ")),
        journal(answered("PINGRESP")),
        journal(sent("SUBSCRIBE", packet_id=1, filters=[]), answered("SUBACK", packet_id=2, reason_codes=[0])),
        journal(*({**entry, **MOCK} for entry in ping)),
    ):
        found = words(oracle.exchange(entries))
        assert "the broker should have answered at least 1 request(s) during the call(s), it " in found
        assert "[RD-004]" in found


def subscribed(entries: Any, filter: str, qos: int | None) -> list[Finding]:
    return fed(oracle.Subscriptions(), entries).granted(filter, qos=qos)


def test_a_subscription_counts_when_the_broker_grants_it_as_asked() -> None:
    assert subscribed(journal(*SUBSCRIBED), "sensors/#", 1) == []
    assert "it answered with reason code 0x80" in words(subscribed(journal(*SUBSCRIBED), "x", 0))
    assert "it has granted QoS 1" in words(subscribed(journal(*SUBSCRIBED), "sensors/#", 2))
    assert "it saw no SUBSCRIBE" in words(subscribed(journal(), "x", 0))
    unanswered = words(subscribed(journal(SUBSCRIBED[0]), "x", 0))
    assert "it saw SUBSCRIBE for [['x', 'sensors/#']]" in unanswered
    assert "[MQT-002]" in unanswered


def test_a_message_counts_as_delivered_to_the_adapter_only() -> None:
    delivery = publish(b"nonce", direction="out", topic="sensors/t")
    assert oracle.delivered(journal(delivery), topic="sensors/t", payload=b"nonce") == []
    nobody = oracle.delivered(journal({**delivery, **MOCK}), topic="sensors/t", payload=b"nonce")
    assert "the broker had nobody to send it to [MQT-004]" in words(nobody)
    assert "the broker sent it ['sensors/t']" in words(
        oracle.delivered(journal(delivery), topic="sensors/t", payload=b"x")
    )


def test_a_publication_counts_once_and_as_it_was_asked_for() -> None:
    wanted: dict[str, Any] = {"topic": "control/pump", "payload": b"50"}
    others = (publish(b"noise", **KIT), publish(b"noise", **MOCK), publish(b"noise", direction="out"))
    assert oracle.published_once(journal(publish(), *others), **wanted) == []
    assert oracle.published_once(journal(publish(qos=1, packet_id=4)), qos=1, **wanted) == []
    never = words(oracle.published_once(journal(*others), **wanted))
    assert "b'50' on 'control/pump' once and nothing else, it received 0 message(s) [MQT-001]" in never
    twice = words(oracle.published_once(journal(publish(), publish(dup=True)), **wanted))
    assert "it received 2 message(s) [WR-003]" in twice
    assert "< PUBLISH 'control/pump' QoS 0 b'50'; < PUBLISH" in twice
    for wrong in (publish(b"51"), publish(topic="control/pump2")):
        assert "it received 1 message(s) [MQT-001]" in words(oracle.published_once(journal(wrong), **wanted))
    retained = words(oracle.published_once(journal(publish(retain=True)), **wanted))
    assert "with QoS 0 and not retained, it came with QoS 0 and retained [MQT-003]" in retained


OWN = {"topic": "acme/status", "retain": True}


def test_what_an_adapter_publishes_of_itself_elsewhere_is_its_own_affair() -> None:
    own = publish(b"online", **OWN)
    reported = publish(b"x", topic="spBv1.0/factory/NDATA/line")
    assert oracle.published_once(journal(own, publish(), reported), topic="control/pump", payload=b"50") == []
    commanded = publish(b"x", topic="spBv1.0/factory/DCMD/line/device-1")
    for other in (publish(b"51", topic="control/fan"), commanded, publish(topic="elsewhere")):
        found = oracle.published_once(journal(publish(), other), topic="control/pump", payload=b"50")
        assert "it received 2 message(s) [WR-003]" in words(found)


@pytest.mark.parametrize(
    ("declared", "topic"),
    [("line/+/set", "line/7/set"), ("line/#", "line/7/set"), ("line/#", "line"), ("+/7/#", "line/7"), ("#", "any")],
)
def test_a_subject_declares_further_topics_of_commands(declared: str, topic: str) -> None:
    sent_there = journal(publish(topic=topic))
    assert oracle.no_command(sent_there) == []
    assert "it saw 1 [WR-010]" in words(oracle.no_command(sent_there, {"command_topics": [declared]}))
    assert oracle.no_command(journal(publish(topic="line7/set")), {"command_topics": ["line/+/set"]}) == []
    assert oracle.no_command(journal(publish(topic="$own/line")), {"command_topics": ["#"]}) == []


def test_a_message_that_is_delivered_again_over_another_connection_is_one_message() -> None:
    wanted: dict[str, Any] = {"topic": "control/pump", "payload": b"50", "qos": None}
    first, again = publish(qos=1, packet_id=4, connection=1), publish(qos=1, packet_id=4, dup=True, connection=2)
    assert oracle.published_once(journal(first, again), **wanted) == []
    for other in ({"connection": 1}, {"dup": False}, {"packet_id": 5}, {"qos": 0}):
        twice = oracle.published_once(journal(first, {**again, **other}), **wanted)
        assert "it received 2 message(s)" in words(twice)
        assert "[WR-003]" in words(twice)


def test_a_message_that_must_not_come_is_found_also_when_it_is_malformed() -> None:
    own = publish(b"online", **OWN)
    assert oracle.not_published(journal(*SUBSCRIBED, own, publish(**KIT)), b"50") == []
    assert "no PUBLISH from the adapter, it saw 1 [ERR-006]" in words(
        oracle.not_published(journal(own, publish()), b"50")
    )
    malformed = sent("malformed", packet="PUBLISH", reason="empty topic")
    assert "empty topic" in words(oracle.not_published(journal(own, malformed), b"50"))
    assert "it saw 1" in words(oracle.not_published(journal(publish(b"other")), b"50"))


def test_a_subscription_that_must_not_come_is_found_also_when_it_is_malformed() -> None:
    assert oracle.not_subscribed(journal(*SUBSCRIBED), "stress/#") == []
    assert "no SUBSCRIBE from the adapter, it saw 1 [ADR-007]" in words(
        oracle.not_subscribed(journal(*SUBSCRIBED), "sensors/#")
    )
    malformed = sent("malformed", packet="SUBSCRIBE", reason="SUBSCRIBE 't' with the options 0x05")
    assert "the options 0x05" in words(oracle.not_subscribed(journal(malformed), "stress/#"))
    (once,) = oracle.not_subscribed(journal(*SUBSCRIBED, malformed), "sensors/#", "stress/#", "")
    assert "it saw 2" in once.message


def test_a_device_that_must_not_be_reported_is_told_from_the_adapters_own_node() -> None:
    born = publish(topic="spBv1.0/factory/NBIRTH/line")
    assert oracle.not_reported(journal(born, publish(b"online", **OWN)), "device-1") == []
    device = publish(topic="spBv1.0/factory/DBIRTH/line/device-1")
    assert "it saw 1 [WR-004]" in words(oracle.not_reported(journal(born, device), "device-1"))


def test_a_session_that_ends_is_found() -> None:
    assert oracle.session_stays_up(journal(*SUBSCRIBED, sent("DISCONNECTED", **MOCK))) == []
    tried = {"connection": 77, "client_id": None}
    assert (
        oracle.session_stays_up(journal(*SUBSCRIBED, sent("CONNECTED", **tried), sent("DISCONNECTED", **tried))) == []
    )
    ended = words(oracle.session_stays_up(journal(sent("DISCONNECT"), sent("DISCONNECTED"))))
    assert "should have stayed up, it ended with DISCONNECT and DISCONNECTED [ADR-006]" in ended


def test_a_connection_made_for_one_call_may_end_in_an_orderly_way() -> None:
    call = (sent("CONNECT"), sent("DISCONNECT"), sent("DISCONNECTED"))
    assert oracle.session_stays_up(journal(*call)) == []
    dropped = (sent("CONNECT"), sent("malformed", packet="PUBLISH", reason="empty topic"), sent("DISCONNECTED"))
    assert oracle.session_stays_up(journal(*dropped)) != []
    assert oracle.session_stays_up(journal(sent("CONNECT"), sent("DISCONNECTED"))) != []


def test_a_subscription_lasts_until_it_is_ended_or_its_connection_is() -> None:
    assert subscribed(journal(*SUBSCRIBED, publish()), "sensors/#", None) == []
    ended = sent("UNSUBSCRIBE", packet_id=4, filters=[{"filter": "sensors/#"}])
    assert subscribed(journal(*SUBSCRIBED, ended), "sensors/#", None) != []
    assert subscribed(journal(*SUBSCRIBED, sent("DISCONNECTED")), "sensors/#", None) != []
    lowered = (
        sent("SUBSCRIBE", packet_id=5, filters=[{"filter": "sensors/#", "qos": 0}]),
        answered("SUBACK", packet_id=5, reason_codes=[0]),
    )
    assert subscribed(journal(*SUBSCRIBED, *lowered), "sensors/#", 1) != []
    assert subscribed(journal(*SUBSCRIBED), "x", None) != []


def test_a_message_that_was_reported_as_failed_must_never_come() -> None:
    assert oracle.never_published(journal(publish(b"other"), publish(b"50", **KIT)), b"50") == []
    late = words(oracle.never_published(journal(publish(b"50", topic="somewhere", dup=True)), b"50"))
    assert "should never have been published, the broker received it 1 time(s) [WR-010]" in late


def test_a_quality_of_service_that_cannot_be_asked_for_may_be_any() -> None:
    wanted: dict[str, Any] = {"topic": "control/pump", "payload": b"50", "qos": None}
    assert oracle.published_once(journal(publish(qos=1, packet_id=4)), **wanted) == []
    retained = words(oracle.published_once(journal(publish(retain=True)), **wanted))
    assert "b'50' on 'control/pump' retained" not in retained


def test_commands_in_a_guarded_session_are_counted_and_the_first_ones_are_shown() -> None:
    assert fed(oracle.Publications(), journal(*SUBSCRIBED, publish(topic="acme/status"))).guarded({}) == []
    (finding,) = fed(oracle.Publications(), journal(*(publish() for _ in range(30)))).guarded({})
    assert finding.message == "the broker should have seen no PUBLISH from the adapter, it saw 30"
    assert (finding.requirement, finding.strength) == ("WR-004", "MUST")
    assert finding.evidence is not None
    assert finding.evidence.endswith("; … 20 more")
    told = fed(oracle.Publications(), journal(publish(topic="line/set")))
    assert told.guarded({}) == []
    assert len(told.guarded({"command_topics": ["line/#"]})) == 1
    malformed = fed(oracle.Publications(), journal(sent("malformed", packet=None, reason="no packet")))
    assert len(malformed.guarded({})) == 1


def test_a_command_is_not_lost_among_thousands_of_own_topics() -> None:
    own = [publish(topic=f"acme/{number}") for number in range(1200)]
    told = fed(oracle.Publications(), journal(*SUBSCRIBED, *own, publish(topic="control/pump")))
    (finding,) = told.guarded({})
    assert "it saw 1" in finding.message


def test_what_a_guarded_session_leaves_behind_on_a_topic_of_its_own_is_a_warning() -> None:
    (finding,) = fed(oracle.Publications(), journal(*(publish(b"online", **OWN) for _ in range(3)))).guarded({})
    assert (finding.code, finding.requirement, finding.strength) == ("retained_own", "WR-004", "SHOULD")
    assert "'acme/status'" in finding.message


def test_a_long_session_leaves_no_more_behind_than_a_short_one() -> None:
    ended = sent("UNSUBSCRIBE", packet_id=4, filters=[{"filter": "sensors/#"}])
    cycle = journal(*SUBSCRIBED, ended, sent("DISCONNECTED"))
    short, long = (fed(oracle.Subscriptions(), cycle * times) for times in (1, 1000))
    sizes = [
        [len(value) for value in vars(one).values() if isinstance(value, dict | set | list)] for one in (short, long)
    ]
    assert sizes[0] == sizes[1]


LEAVE = sent("UNSUBSCRIBE", packet_id=4, filters=[{"filter": "sensors/#"}])


def test_a_subscription_has_ended_when_the_broker_was_asked_to_and_answered() -> None:
    def left(*packets: Entry) -> list[Finding]:
        entries = journal(*packets)
        asked = {entry["packet_id"]: entry["seq"] for entry in entries if entry["kind"] == "UNSUBSCRIBE"}
        for entry in entries:
            if entry["kind"] == "UNSUBACK":
                entry["answers"] = asked[entry["packet_id"]]
        return oracle.unsubscribed(entries, "sensors/#")

    assert left(LEAVE, answered("UNSUBACK", packet_id=4)) == []
    assert "answered no such UNSUBSCRIBE [MQT-002]" in words(left(LEAVE))
    other = {**LEAVE, "filters": [{"filter": "x"}]}
    assert left(other, answered("UNSUBACK", packet_id=4)) != []


def test_an_ended_subscription_is_one_that_no_open_connection_has() -> None:
    def ended(*packets: Entry) -> list[Finding]:
        return fed(oracle.Subscriptions(), journal(*SUBSCRIBED, *packets)).ended("sensors/#")

    assert ended(LEAVE) == ended(answered("DISCONNECTED", reason="")) == []
    assert "should have ended, the broker still has it [MQT-002]" in words(ended())
    assert fed(oracle.Subscriptions(), journal(*SUBSCRIBED)).ended("x") == []


def test_what_is_said_of_a_message_that_came_again_is_what_the_packets_say() -> None:
    first = publish(qos=1, packet_id=4, connection=1)
    entries = journal(first, publish(qos=1, packet_id=5, connection=1))
    assert (
        delivered_again(entries, entries)
        == "with QoS 1, none of them with DUP; the broker had withheld the PUBACK of the first"
    )
    puback = answered("PUBACK", packet_id=4, connection=1)
    entries = journal(first, puback, publish(qos=1, packet_id=5, dup=True, connection=1))
    told = delivered_again(entries, [entries[0], entries[2]])
    assert "1 of them with DUP" in told
    assert told.endswith("the broker had sent the PUBACK of the first")
    assert delivered_again(entries, entries[:1]) == ""
    once = journal(publish(), publish())
    assert delivered_again(once, once) == ""


def test_a_connection_without_a_connect_is_none_of_the_session_whenever_it_was_made() -> None:
    ended = journal({"direction": "in", "kind": "DISCONNECTED", "connection": 7})
    assert oracle.session_stays_up(ended)
    unnamed = [{**entry, "client_id": None} for entry in ended]
    assert oracle.session_stays_up(unnamed) == []
