"""The broker with an independent client: the behaviours that the Eclipse Paho interoperability suite checks.

The tests are written anew with paho-mqtt as the client; where it matters they run with both protocol versions.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Iterator

import pytest
from mqtt_tools import PATIENCE_S, Peer, RunningBroker, running_broker
from pytest_otmcp.mocks.mqtt.broker import Limits

FOREVER = {"SessionExpiryInterval": 0xFFFFFFFF}


@pytest.fixture
def broker() -> Iterator[RunningBroker]:
    with running_broker() as running:
        yield running


@pytest.fixture(params=[4, 5], ids=["3.1.1", "5"])
def version(request: pytest.FixtureRequest) -> int:
    found: int = request.param
    return found


def lasting(version: int) -> dict[str, object]:
    """Return the settings of a session that outlives its connection."""
    return {"version": version, "clean": False, **({"properties": FOREVER} if version == 5 else {})}


# -- both versions --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("granted", [0, 1, 2])
def test_messages_arrive_at_the_lower_of_both_qos(broker: RunningBroker, version: int, granted: int) -> None:
    with Peer(broker.port, "a", version=version) as peer:
        assert peer.subscribe("t", granted) == [granted]
        for qos in (0, 1, 2):
            assert peer.publish("t", f"qos {qos}".encode(), qos) == 0
        messages = [peer.next() for _ in range(3)]
        assert [(one.payload, one.qos) for one in messages] == [
            (f"qos {qos}".encode(), min(qos, granted)) for qos in (0, 1, 2)
        ]
        assert not any(one.retain or one.dup for one in messages)


def test_a_message_of_256_kb_arrives_unchanged(broker: RunningBroker, version: int) -> None:
    payload = bytes(range(256)) * 1024
    with Peer(broker.port, "a", version=version) as peer:
        peer.subscribe("t", 1)
        peer.publish("t", payload, 1)
        assert peer.next().payload == payload


def test_messages_of_one_publisher_keep_their_order(broker: RunningBroker, version: int) -> None:
    with Peer(broker.port, "a", version=version) as receiver, Peer(broker.port, "b", version=version) as sender:
        receiver.subscribe("t/#", 2)
        for number in range(300):
            sender.client.publish("t/x", str(number).encode(), 1)
        assert receiver.payloads(300) == [str(number).encode() for number in range(300)]


def test_retained_messages_reach_later_subscribers_until_cleared(broker: RunningBroker, version: int) -> None:
    with Peer(broker.port, "a", version=version) as sender, Peer(broker.port, "b", version=version) as receiver:
        for qos in (0, 1, 2):
            sender.publish(f"r/{qos}", b"kept", qos, retain=True)
        sender.publish("r/1", b"newer", 1, retain=True)
        receiver.subscribe("r/+", 2)
        found = sorted(
            (one.topic, bytes(one.payload), one.qos, one.retain) for one in (receiver.next() for _ in range(3))
        )
        assert found == [("r/0", b"kept", 0, True), ("r/1", b"newer", 1, True), ("r/2", b"kept", 2, True)]
        receiver.unsubscribe("r/+")
        for qos in (0, 1, 2):
            sender.publish(f"r/{qos}", b"", qos, retain=True)
        receiver.subscribe("r/+", 2)
        assert receiver.nothing_more()


def test_an_empty_retained_message_is_delivered_to_those_who_are_there(broker: RunningBroker, version: int) -> None:
    with Peer(broker.port, "a", version=version) as peer:
        peer.subscribe("t")
        peer.publish("t", b"", 0, retain=True)
        message = peer.next()
        assert (message.payload, message.retain) == (b"", False)


def test_messages_wait_for_a_session_that_is_offline(broker: RunningBroker, version: int) -> None:
    with Peer(broker.port, "a", **lasting(version)) as away:
        assert not away.session_present
        away.subscribe("q/#", 2)
    with Peer(broker.port, "b", version=version) as sender:
        for qos in (0, 1, 2):
            sender.publish(f"q/{qos}", str(qos).encode(), qos)
    with Peer(broker.port, "a", **lasting(version)) as back:
        assert back.session_present
        assert back.payloads(2) == [b"1", b"2"]
        assert back.nothing_more()


def test_a_clean_start_forgets_the_session(broker: RunningBroker, version: int) -> None:
    with Peer(broker.port, "a", **lasting(version)) as before:
        before.subscribe("t", 1)
    with Peer(broker.port, "a", version=version) as fresh:
        assert not fresh.session_present
        fresh.publish("t", b"x", 1)
        assert fresh.nothing_more()


def test_unacknowledged_messages_are_delivered_again(broker: RunningBroker, version: int) -> None:
    silent = Peer(broker.port, "a", manual_ack=True, **lasting(version)).connect()
    silent.subscribe("t", 1)
    with Peer(broker.port, "b", version=version) as sender:
        sender.publish("t", b"one", 1)
        sender.publish("t", b"two", 1)
    assert silent.payloads(2) == [b"one", b"two"]
    silent.cut()
    broker.wait(kind="DISCONNECTED", client_id="a")
    with Peer(broker.port, "a", **lasting(version)) as back:
        messages = [back.next(), back.next()]
        assert [(bytes(one.payload), one.dup) for one in messages] == [(b"one", True), (b"two", True)]


def test_a_lost_connection_publishes_the_will_and_an_orderly_end_does_not(broker: RunningBroker, version: int) -> None:
    with Peer(broker.port, "witness", version=version) as witness:
        witness.subscribe("w", 2)
        with Peer(broker.port, "a", version=version, will={"topic": "w", "payload": b"no"}):
            pass
        dying = Peer(
            broker.port, "b", version=version, will={"topic": "w", "payload": b"yes", "qos": 2, "retain": True}
        )
        dying.connect().cut()
        message = witness.next()
        assert (message.payload, message.qos, message.retain) == (b"yes", 2, False)
        assert witness.nothing_more()
    assert broker.broker.retained["w"].payload == b"yes"


def test_a_silent_client_is_disconnected_and_its_will_published(broker: RunningBroker, version: int) -> None:
    # The broker acts after one and a half times the keep-alive. The client's network loop does not run meanwhile.
    with Peer(broker.port, "witness", version=version, keepalive=0) as witness:
        witness.subscribe("w")
        silent = Peer(broker.port, "a", version=version, keepalive=60, will={"topic": "w", "payload": b"gone"})
        silent.connect().client.loop_stop()
        broker.leap(50)
        assert witness.nothing_more()
        broker.leap(50)
        assert witness.next().payload == b"gone"
        silent.cut()
    assert broker.wait(kind="DISCONNECTED", client_id="a")[0]["reason"] == "keep-alive timeout"


def test_a_client_that_pings_is_not_disconnected(
    broker: RunningBroker, version: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    ahead_s = 0
    monkeypatch.setattr("paho.mqtt.client.time_func", lambda: time.monotonic() + ahead_s)
    pongs: queue.Queue[str] = queue.Queue()
    with Peer(broker.port, "a", version=version, keepalive=60) as peer:
        peer.client.on_log = lambda client, userdata, level, text: pongs.put(text) if "PINGRESP" in text else None
        # The clocks of both leap by more than the keep-alive and less than one and a half times it. With real clocks
        # and a keep-alive of a second a ping could come too late without a fault of client or broker.
        for _ in range(2):
            broker.leap(65)
            ahead_s += 65
            assert pongs.get(timeout=PATIENCE_S) == "Received PINGRESP"
        assert len(broker.entries(kind="PINGREQ", client_id="a")) == 2
        peer.subscribe("t")
        assert broker.entries(kind="DISCONNECTED") == []


def test_overlapping_subscriptions_yield_one_copy_at_the_highest_qos(broker: RunningBroker, version: int) -> None:
    with Peer(broker.port, "a", version=version) as peer:
        peer.subscribe("t/#", 2)
        peer.subscribe("t/+", 1)
        peer.publish("t/x", b"once", 2)
        message = peer.next()
        assert (message.payload, message.qos) == (b"once", 2)
        assert peer.nothing_more()


def test_a_new_subscription_to_the_same_filter_replaces_the_old_one(broker: RunningBroker, version: int) -> None:
    with Peer(broker.port, "a", version=version) as peer:
        peer.subscribe("t", 2)
        peer.subscribe("t", 0)
        peer.publish("t", b"x", 2)
        assert peer.next().qos == 0
        assert peer.nothing_more()


def test_wildcards_do_not_match_topics_that_begin_with_a_dollar(broker: RunningBroker, version: int) -> None:
    with Peer(broker.port, "a", version=version) as peer:
        peer.subscribe("#")
        peer.subscribe("+/x")
        peer.publish("$hidden/x", b"x", 1)
        assert peer.nothing_more()
        peer.subscribe("$hidden/#")
        peer.publish("$hidden/x", b"y", 1)
        assert peer.payloads(1) == [b"y"]


def test_unsubscribing_ends_one_subscription_and_no_other(broker: RunningBroker, version: int) -> None:
    with Peer(broker.port, "a", version=version) as peer:
        for topic in ("t/1", "t/2"):
            peer.subscribe(topic)
        peer.unsubscribe("t/1")
        for topic in ("t/1", "t/2"):
            peer.publish(topic, topic.encode(), 1)
        assert peer.payloads(1) == [b"t/2"]
        assert peer.nothing_more()


def test_a_second_connection_of_a_client_takes_over(broker: RunningBroker, version: int) -> None:
    first = Peer(broker.port, "a", **lasting(version)).connect()
    first.subscribe("t", 1)
    with Peer(broker.port, "a", **lasting(version)) as second:
        assert second.session_present
        code = first.disconnects.get(timeout=PATIENCE_S)
        assert version == 4 or code.value == 0x8E
        first.client.loop_stop()
        second.publish("t", b"x", 1)
        assert second.payloads(1) == [b"x"]
    assert broker.wait(kind="DISCONNECTED", client_id="a")[0]["reason"] == "session taken over"


def test_clients_without_id_are_told_apart(broker: RunningBroker, version: int) -> None:
    with Peer(broker.port, "", version=version) as one, Peer(broker.port, "", version=version) as other:
        one.subscribe("t")
        other.subscribe("t")
        one.publish("t", b"x", 1)
        assert one.payloads(1) == other.payloads(1) == [b"x"]


# -- MQTT 5 ---------------------------------------------------------------------------------------------------


def test_a_client_without_id_is_told_the_one_it_got(broker: RunningBroker) -> None:
    with Peer(broker.port) as peer:
        name = peer.connack_properties.AssignedClientIdentifier
        assert [entry["client_id"] for entry in broker.entries(kind="CONNACK")] == [name]


def test_the_broker_states_its_limits() -> None:
    limits = Limits(receive_maximum=7, topic_alias_maximum=3, maximum_packet_size=4096, server_keep_alive=30)
    with running_broker(limits) as broker, Peer(broker.port) as peer:
        stated = peer.connack_properties
        assert (stated.ReceiveMaximum, stated.TopicAliasMaximum) == (7, 3)
        assert (stated.MaximumPacketSize, stated.ServerKeepAlive) == (4096, 30)


def test_a_session_expires_after_its_interval(broker: RunningBroker) -> None:
    for present in (False, True):
        with Peer(broker.port, "a", clean=False, properties={"SessionExpiryInterval": 60}) as peer:
            assert peer.session_present == present
            peer.subscribe("t", 1)
        broker.wait(count=1 + present, kind="DISCONNECTED")
        broker.leap(50)
        assert "a" in broker.broker.sessions
    broker.leap(20)
    assert "a" not in broker.broker.sessions
    with Peer(broker.port, "a", clean=False) as late:
        assert not late.session_present


def test_a_disconnect_may_change_the_session_expiry(broker: RunningBroker) -> None:
    peer = Peer(broker.port, "a", clean=False, properties=FOREVER).connect()
    peer.disconnect(SessionExpiryInterval=0)
    broker.wait(kind="DISCONNECTED")
    with Peer(broker.port, "a", clean=False, properties={"SessionExpiryInterval": 1}) as again:
        assert not again.session_present
        again.disconnect(SessionExpiryInterval=0xFFFFFFFF)
    broker.wait(count=2, kind="DISCONNECTED")
    assert broker.broker.sessions["a"].expiry_s == float("inf")


def test_user_properties_and_payload_format_travel_with_a_message_at_every_qos(broker: RunningBroker) -> None:
    pairs = [("a", "2"), ("c", "3"), ("a", "4")]
    with Peer(broker.port) as peer:
        peer.subscribe("t", 2)
        for qos in (0, 1, 2):
            peer.publish("t", b"x", qos, UserProperty=pairs, PayloadFormatIndicator=1, ContentType="text/plain")
            found = peer.next().properties
            assert found is not None
            assert found.UserProperty == pairs
            assert (found.PayloadFormatIndicator, found.ContentType) == (1, "text/plain")


def test_a_request_carries_where_to_answer(broker: RunningBroker) -> None:
    with Peer(broker.port, "client") as client, Peer(broker.port, "server") as server:
        client.subscribe("answers/1", 1)
        server.subscribe("requests", 1)
        client.publish("requests", b"?", 1, ResponseTopic="answers/1", CorrelationData=b"\x00\xfe")
        request = server.next().properties
        assert request is not None
        server.publish(request.ResponseTopic, b"!", 1, CorrelationData=request.CorrelationData)
        answer = client.next()
        assert answer.payload == b"!"
        assert answer.properties is not None
        assert answer.properties.CorrelationData == b"\x00\xfe"


def test_a_message_expires_while_it_waits(broker: RunningBroker) -> None:
    with Peer(broker.port, "a", clean=False, properties=FOREVER) as away:
        away.subscribe("t", 2)
    with Peer(broker.port, "b") as sender:
        sender.publish("t", b"short", 1, MessageExpiryInterval=1)
        sender.publish("t", b"long", 2, MessageExpiryInterval=60)
    # A second must pass; no event shows that it has passed.
    time.sleep(1.05)
    with Peer(broker.port, "a", clean=False, properties=FOREVER) as back:
        message = back.next()
        assert message.payload == b"long"
        assert message.properties is not None
        assert 50 < message.properties.MessageExpiryInterval < 60
        assert back.nothing_more()


def test_a_retained_message_expires(broker: RunningBroker) -> None:
    with Peer(broker.port, "a") as peer:
        peer.publish("t", b"short", 1, retain=True, MessageExpiryInterval=1)
        peer.publish("u", b"long", 1, retain=True, MessageExpiryInterval=60)
        time.sleep(1.05)
        peer.subscribe("t", 1)
        peer.subscribe("u", 1)
        assert peer.payloads(1) == [b"long"]
        assert peer.nothing_more()


def test_no_local_spares_the_publisher(broker: RunningBroker) -> None:
    with Peer(broker.port, "a") as one, Peer(broker.port, "b") as other:
        one.subscribe("t", 1, noLocal=True)
        other.subscribe("t", 1, noLocal=True)
        one.publish("t", b"x", 1)
        assert other.payloads(1) == [b"x"]
        assert one.nothing_more()


def test_retain_as_published_keeps_the_flag(broker: RunningBroker) -> None:
    with Peer(broker.port, "a") as peer:
        peer.subscribe("t", 1, retainAsPublished=True)
        peer.publish("t", b"1", 1, retain=False)
        peer.publish("t", b"2", 1, retain=True)
        assert [(one.payload, one.retain) for one in (peer.next(), peer.next())] == [(b"1", False), (b"2", True)]


@pytest.mark.parametrize(("handling", "expected"), [(0, [True, True]), (1, [True, False]), (2, [False, False])])
def test_retain_handling_decides_when_retained_messages_are_sent(
    broker: RunningBroker, handling: int, expected: list[bool]
) -> None:
    with Peer(broker.port, "a") as peer:
        peer.publish("t", b"kept", 1, retain=True)
        for wanted in expected:
            peer.subscribe("t", 1, retainHandling=handling)
            if wanted:
                assert peer.payloads(1) == [b"kept"]
            assert peer.nothing_more()


def test_subscription_identifiers_tell_which_subscriptions_matched(broker: RunningBroker) -> None:
    with Peer(broker.port, "a") as one, Peer(broker.port, "b") as other:
        one.subscribe("t", 2, identifier=456_789)
        other.subscribe("t", 2, identifier=2)
        other.subscribe("t/#", 2, identifier=3)
        other.publish("t", b"x", 1)
        for peer, expected in ((one, {456_789}), (other, {2, 3})):
            found = peer.next().properties
            assert found is not None
            assert set(found.SubscriptionIdentifier) == expected
        assert other.nothing_more()


def test_a_client_may_use_topic_aliases_within_a_connection(broker: RunningBroker) -> None:
    with Peer(broker.port, "a") as peer:
        peer.subscribe("t", 1)
        peer.publish("t", b"1", 1, TopicAlias=1)
        peer.client.publish("t", b"2", 1)
        peer.publish("t", b"3", 1, TopicAlias=16)
        assert [one.topic for one in (peer.next(), peer.next(), peer.next())] == ["t", "t", "t"]


def test_the_broker_uses_the_topic_aliases_that_a_client_allows(broker: RunningBroker) -> None:
    with Peer(broker.port, "a", properties={"TopicAliasMaximum": 1}) as peer:
        peer.subscribe("+", 2)
        for topic in ("t", "t", "u", "t"):
            peer.publish(topic, b"x", 1)
        found = [(one.topic, getattr(one.properties, "TopicAlias", None)) for one in (peer.next() for _ in range(4))]
    assert found == [("t", 1), ("", 1), ("u", None), ("", 1)]
    assert [entry["topic"] for entry in broker.entries(direction="out", kind="PUBLISH")] == ["t", "t", "u", "t"]


def test_no_more_messages_are_in_flight_than_the_client_can_take(broker: RunningBroker) -> None:
    with Peer(broker.port, "a", manual_ack=True, properties={"ReceiveMaximum": 2}) as peer:
        peer.subscribe("t", 1)
        for number in range(4):
            peer.publish("t", str(number).encode(), 1)
        first, second = peer.next(), peer.next()
        assert peer.nothing_more()
        peer.client.ack(first.mid, 1)
        assert peer.payloads(1) == [b"2"]
        assert peer.nothing_more()
        peer.client.ack(second.mid, 1)
        assert peer.payloads(1) == [b"3"]


def test_a_packet_larger_than_the_client_accepts_is_not_sent(broker: RunningBroker) -> None:
    with Peer(broker.port, "a", properties={"MaximumPacketSize": 100, "ReceiveMaximum": 1}) as peer:
        peer.subscribe("t", 1)
        peer.publish("t", bytes(32), 1)
        peer.publish("t", bytes(100), 1)
        peer.publish("t", b"after", 1)
        assert peer.payloads(2) == [bytes(32), b"after"]
        assert peer.nothing_more()


def test_a_will_is_delayed(broker: RunningBroker) -> None:
    will = {"topic": "w", "payload": b"late", "properties": {"WillDelayInterval": 60, "UserProperty": ("a", "2")}}
    with Peer(broker.port, "witness", keepalive=0) as witness:
        witness.subscribe("w")
        Peer(broker.port, "a", will=will, properties=FOREVER).connect().cut()
        broker.wait(kind="DISCONNECTED", client_id="a")
        broker.leap(50)
        assert witness.nothing_more()
        assert broker.entries(kind="WILL") == []
        broker.leap(20)
        message = witness.next()
        assert message.payload == b"late"
        assert message.properties is not None
        assert message.properties.UserProperty == [("a", "2")]
    assert len(broker.entries(kind="WILL")) == 1


def test_a_will_is_not_delayed_beyond_the_end_of_the_session(broker: RunningBroker) -> None:
    will = {"topic": "w", "payload": b"now", "properties": {"WillDelayInterval": 3600}}
    with Peer(broker.port, "witness", keepalive=0) as witness:
        witness.subscribe("w")
        Peer(broker.port, "a", will=will).connect().cut()
        assert witness.next().payload == b"now"
        Peer(broker.port, "b", will=will, properties={"SessionExpiryInterval": 60}).connect().cut()
        broker.wait(kind="DISCONNECTED", client_id="b")
        assert witness.nothing_more()
        broker.leap(61)
        assert witness.next().payload == b"now"


def test_a_client_that_returns_in_time_takes_its_will_back(broker: RunningBroker) -> None:
    will = {"topic": "w", "payload": b"dead", "properties": {"WillDelayInterval": 3600}}
    with Peer(broker.port, "witness") as witness:
        witness.subscribe("w")
        Peer(broker.port, "a", clean=False, will=will, properties=FOREVER).connect().cut()
        broker.wait(kind="DISCONNECTED", client_id="a")
        with Peer(broker.port, "a", clean=False, properties=FOREVER) as back:
            assert back.session_present
        assert witness.nothing_more()


def test_a_client_may_ask_for_its_will(broker: RunningBroker) -> None:
    from paho.mqtt.packettypes import PacketTypes
    from paho.mqtt.reasoncodes import ReasonCode

    with Peer(broker.port, "witness") as witness:
        witness.subscribe("w")
        leaving = Peer(broker.port, "a", will={"topic": "w", "payload": b"asked for"}).connect()
        leaving.disconnect(reasoncode=ReasonCode(PacketTypes.DISCONNECT, identifier=0x04))
        assert witness.next().payload == b"asked for"


def test_a_shared_subscription_gives_each_message_to_one_member(broker: RunningBroker) -> None:
    with Peer(broker.port, "a") as one, Peer(broker.port, "b") as other, Peer(broker.port, "c") as sender:
        one.subscribe("$share/group/t/+", 1)
        other.subscribe("$share/group/t/+", 1)
        sender.subscribe("$share/another/t/#", 1)
        for number in range(6):
            sender.publish(f"t/{number}", str(number).encode(), 1)
        assert one.payloads(3) == [b"0", b"2", b"4"]
        assert other.payloads(3) == [b"1", b"3", b"5"]
        assert len(sender.payloads(6)) == 6
        assert one.nothing_more()
        assert other.nothing_more()


def test_a_shared_subscription_prefers_members_that_are_there(broker: RunningBroker) -> None:
    with Peer(broker.port, "a", clean=False, properties=FOREVER) as away:
        away.subscribe("$share/group/t", 1)
    with Peer(broker.port, "b") as here:
        here.subscribe("$share/group/t", 1)
        for _ in range(3):
            here.publish("t", b"x", 1)
        assert here.payloads(3) == [b"x"] * 3


def test_a_shared_subscription_gets_no_retained_messages(broker: RunningBroker) -> None:
    with Peer(broker.port, "a") as peer:
        peer.publish("t", b"kept", 1, retain=True)
        peer.subscribe("$share/group/t", 1)
        assert peer.nothing_more()


def test_acknowledgements_tell_when_there_was_nothing_to_do(broker: RunningBroker) -> None:
    with Peer(broker.port, "a") as peer:
        assert peer.publish("nobody/listens", b"x", 1) == 0x10
        assert peer.unsubscribe("never/subscribed") == [0x11]
