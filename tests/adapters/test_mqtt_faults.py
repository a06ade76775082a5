"""The MQTT reference adapter when the broker is silent, refuses, breaks off, or is away: nothing is sent twice or late."""

# In the checkout mypy does not find the installed name of the adapters' folder.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from pytest_otmcp.reference_adapters.core import Lost
from pytest_otmcp.reference_adapters.mqtt.connection import Connection, Endpoint, Message

from .cases import MQTT
from .conftest import PATIENCE_S

pytestmark = pytest.mark.usefixtures("clean")
CASE = MQTT
CLIENT = "mqtt-tests-faults"
LATE_S = 60.0
"""Seconds after which a late answer would come. The tests do not wait so long: they move the adapter's clock on."""
FIRST_PAUSE_S = 0.05
QUIET_S = 0.3


@pytest.fixture(scope="module")
def broker(rig: Any) -> Any:
    return rig.device


@pytest.fixture(scope="module")
def adapter(rig: Any) -> Any:
    """An adapter for this module only: the tests compare its subscriptions."""
    return rig.start("faults", writes="true")


def back(broker: Any, mark: int, client: str = CLIENT) -> None:
    """Wait until the broker has accepted the adapter, so that the next call does not join an attempt that failed."""
    broker.wait(mark, kind="CONNACK", client_id=client, reason_codes=[0])


def sent(broker: Any, mark: int, kind: str | None = None, client: str = CLIENT) -> list[dict[str, Any]]:
    """Return the packets that the adapter sent since the mark."""
    entries = broker.since(mark, direction="in", client_id=client)
    return [entry for entry in entries if kind in (None, entry["kind"])]


def publish(adapter: Any, topic: str, qos: int = 1) -> Any:
    return adapter.call("publish_message", topic=topic, payload="x", qos=qos)


def received(adapter: Any, topic: str) -> list[str]:
    """Return the payloads that the adapter has received, after the broker has delivered everything."""
    adapter.call("get_broker_info")
    return [one["payload"] for one in adapter.call("read_messages", topic=topic).data["messages"]]


def refused(reply: Any) -> tuple[str, str, bool]:
    return reply.error["code"], reply.error["outcome"], reply.error["retryable"]


# -- a message of which nobody knows what became of it --------------------------------------------------------


@pytest.mark.parametrize(
    ("qos", "packet", "action", "code"),
    [
        (1, "PUBLISH", {"no_answer": True}, "timeout"),
        (2, "PUBLISH", {"no_answer": True}, "timeout"),
        (2, "PUBREL", {"no_answer": True}, "timeout"),
        (1, "PUBLISH", {"close": True}, "connection_lost"),
        (2, "PUBLISH", {"close": True}, "connection_lost"),
        (2, "PUBREL", {"reset": True}, "connection_lost"),
        (1, "PUBLISH", {"reset": True}, "connection_lost"),
        (1, "PUBLISH", {"delay_s": LATE_S}, "timeout"),
    ],
)
def test_a_message_without_an_answer_is_unknown_and_never_sent_again(
    adapter: Any, broker: Any, qos: int, packet: str, action: dict[str, Any], code: str
) -> None:
    before = adapter.call("get_broker_info").meta["connection"]["generation"]
    mark = broker.mark()
    broker.fault({"packet": packet, "client_id": CLIENT, "times": 1, "action": action})
    call = adapter.start("publish_message", {"topic": "once", "payload": "x", "qos": qos})
    if code == "timeout":
        broker.wait(mark, kind=packet, direction="in", client_id=CLIENT)
        adapter.pass_time()
    reply = adapter.reply("publish_message", call)
    assert refused(reply) == (code, "unknown", False)
    assert reply.meta["attempts"] == 1
    assert reply.meta["connection"] == {"state": "disconnected", "generation": before}
    assert reply.meta["trace"]["topic"] == "once"
    # The adapter reconnects by itself; a replay would be in the journal once the next message is acknowledged.
    back(broker, mark)
    after = publish(adapter, "next", 2)
    assert after.data["delivery"] == "acknowledged"
    assert after.meta["connection"]["generation"] == before + 1
    assert [entry["topic"] for entry in sent(broker, mark, "PUBLISH")] == ["once", "next"]
    assert [entry["dup"] for entry in sent(broker, mark, "PUBLISH")] == [False, False]
    # The second half of a QoS 2 exchange that was given up is not repeated either.
    assert len(sent(broker, mark, "PUBREL")) == 1 + (packet == "PUBREL")


def test_many_messages_that_fail_together_are_sent_once_each(adapter: Any, broker: Any) -> None:
    adapter.call("get_broker_info")
    mark = broker.mark()
    broker.fault({"packet": "PUBLISH", "client_id": CLIENT, "times": 40, "action": {"no_answer": True}})
    topics = [f"together/{i}" for i in range(40)]
    ids = adapter.start_together(*(("publish_message", {"topic": one, "payload": "x", "qos": 1}) for one in topics))
    # All messages are on their way before the first of them times out.
    broker.wait(mark, count=40, kind="PUBLISH", direction="in", client_id=CLIENT)
    adapter.pass_time()
    outcomes = {adapter.reply("publish_message", one).error["outcome"] for one in ids}
    assert outcomes == {"unknown"}
    back(broker, mark)
    assert publish(adapter, "next").data["delivery"] == "acknowledged"
    # More than twenty were in flight: paho's own limit would have kept the others for later.
    assert [entry["topic"] for entry in sent(broker, mark, "PUBLISH")] == [*topics, "next"]


def test_the_deadline_ends_a_call_and_what_it_had_begun(rig: Any, broker: Any) -> None:
    # Only the deadline can end this adapter's calls.
    patient = rig.start("patient", writes="true", MQTT_TIMEOUT_S="600")
    client = "mqtt-tests-patient"
    patient.call("get_broker_info")
    mark = broker.mark()
    broker.fault({"packet": "PUBREL", "client_id": client, "action": {"no_answer": True}})
    call = patient.start("publish_message", {"topic": "late", "payload": "x", "qos": 2})
    broker.wait(mark, kind="PUBREL", direction="in", client_id=client)
    patient.pass_time()
    patient.pass_time()
    assert refused(patient.reply("publish_message", call)) == ("timeout", "unknown", False)
    back(broker, mark, client)
    broker.fault()
    patient.call("get_broker_info")
    assert len(broker.since(mark, kind="PUBLISH", direction="in", client_id=client)) == 1
    mark = broker.mark()
    broker.fault({"packet": "UNSUBSCRIBE", "client_id": client, "action": {"no_answer": True}})
    call = patient.start("get_broker_info", {})
    broker.wait(mark, kind="UNSUBSCRIBE", direction="in", client_id=client)
    patient.pass_time()
    patient.pass_time()
    assert patient.reply("get_broker_info", call).error["code"] == "timeout"
    patient.close()


def test_what_the_socket_could_not_take_in_time_is_not_sent_later(adapter: Any, broker: Any) -> None:
    adapter.call("get_broker_info")
    mark = broker.mark()
    os.kill(broker.pid, signal.SIGSTOP)
    try:
        for number in range(64):
            call = adapter.start("publish_message", {"topic": f"stuck/{number}", "payload": "x" * 1_000_000, "qos": 0})
            adapter.pass_time()
            reply = adapter.reply("publish_message", call)
            if not reply.envelope["success"]:
                break
    finally:
        os.kill(broker.pid, signal.SIGCONT)
    assert refused(reply) == ("timeout", "unknown", False)
    back(broker, mark)
    assert adapter.call("get_broker_info").envelope["success"]
    assert f"stuck/{number}" not in [entry["topic"] for entry in sent(broker, mark, "PUBLISH")]


# -- requests that change nothing ------------------------------------------------------------------------------


def test_a_subscription_without_an_answer_is_not_listed(adapter: Any, broker: Any) -> None:
    adapter.call("get_broker_info")
    mark = broker.mark()
    broker.fault({"packet": "SUBSCRIBE", "client_id": CLIENT, "times": 1, "action": {"no_answer": True}})
    call = adapter.start("subscribe_topic", {"topic": "silent/#"})
    broker.wait(mark, kind="SUBSCRIBE", direction="in", client_id=CLIENT)
    adapter.pass_time()
    assert refused(adapter.reply("subscribe_topic", call)) == ("timeout", "not_applicable", True)
    assert adapter.call("list_subscriptions").data["subscriptions"] == []
    back(broker, mark)
    assert adapter.call("subscribe_topic", topic="silent/#").data["granted_qos"] == 0
    adapter.call("unsubscribe_topic", topic="silent/#")


def test_a_message_that_comes_before_the_answer_to_its_subscription_is_kept(adapter: Any, broker: Any) -> None:
    adapter.call("get_broker_info")
    mark = broker.mark()
    broker.fault({"packet": "SUBSCRIBE", "client_id": CLIENT, "times": 1, "action": {"delay_s": 0.5}})
    call = adapter.start("subscribe_topic", {"topic": "early/#"})
    broker.wait(mark, kind="SUBSCRIBE", direction="in", client_id=CLIENT)
    broker("poke", params={"publish": {"topic": "early/a", "payload": "Zmlyc3Q=", "qos": 0}})
    assert adapter.reply("subscribe_topic", call).data["granted_qos"] == 0
    assert received(adapter, "early/#") == ["first"]
    adapter.call("unsubscribe_topic", topic="early/#")


# -- connecting --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("version", "codes"),
    [
        ("3.1.1", {1: "config_error", 2: "config_error", 4: "auth_failed", 5: "access_denied", 3: "connect_failed"}),
        ("5", {0x84: "config_error", 0x86: "auth_failed", 0x87: "access_denied", 0x88: "connect_failed"}),
    ],
)
def test_each_refusal_of_a_connection_has_its_code(rig: Any, broker: Any, version: str, codes: dict[int, str]) -> None:
    fresh = rig.start("refused", writes="true", MQTT_CLIENT_ID="refused", MQTT_VERSION=version)
    for code, expected in codes.items():
        broker.fault({"packet": "CONNECT", "client_id": "refused", "action": {"reason_code": code}})
        mark = broker.mark()
        reply = publish(fresh, "refused")
        assert (reply.error["code"], reply.error["outcome"], reply.meta["attempts"]) == (expected, "not_sent", 0)
        if expected != "connect_failed":
            # An attempt that can only fail must not be repeated in the background: it could lock an account.
            quiet = broker.within(QUIET_S, mark, kind="CONNECT", client_id="refused", direction="in")
            assert len(quiet) == 1
    broker.fault()
    back(broker, mark, "refused")
    assert publish(fresh, "refused").data["delivery"] == "acknowledged"
    fresh.close()


def test_a_broker_that_does_not_answer_connect_is_a_timeout_for_everybody_who_waits(rig: Any, broker: Any) -> None:
    fresh = rig.start("unanswered", writes="true")
    mark = broker.mark()
    broker.fault({"packet": "CONNECT", "client_id": "mqtt-tests-unanswered", "action": {"no_answer": True}})
    ids = fresh.start_together(*[("publish_message", {"topic": "a", "payload": "x"})] * 8)
    broker.wait(mark, kind="CONNECT", direction="in", client_id="mqtt-tests-unanswered")
    fresh.pass_time()
    replies = [fresh.reply("publish_message", one) for one in ids]
    assert {refused(reply) for reply in replies} == {("timeout", "not_sent", True)}
    # No call waited until its deadline, as it would if the calls made their attempts one after the other.
    assert {reply.error["message"] for reply in replies} == {"the broker did not answer CONNECT"}
    fresh.close()


def test_a_lost_connection_is_tried_again_with_pauses_that_double(adapter: Any, broker: Any) -> None:
    adapter.call("get_broker_info")
    mark = broker.mark()
    broker.fault(
        {"packet": "UNSUBSCRIBE", "client_id": CLIENT, "times": 1, "action": {"reset": True}},
        {"packet": "CONNECT", "client_id": CLIENT, "times": 7, "action": {"reason_code": 0x88}},
    )
    assert adapter.call("get_broker_info").error["code"] == "connect_failed"
    # The adapter reconnects by itself, without a call.
    back(broker, mark)
    tries = [entry["t_ns"] for entry in sent(broker, mark, "CONNECT")]
    assert len(tries) == 8
    # A pause begins when the attempt before it was refused: a busy machine can make it longer, but never shorter. The first
    # attempt is the call's own.
    pauses = [(later - earlier) / 1e9 for earlier, later in itertools.pairwise(tries)][1:]
    assert all(pause >= FIRST_PAUSE_S * 2**number for number, pause in enumerate(pauses)), pauses


@pytest.mark.parametrize(
    ("reason", "code", "outcome"),
    [(0x87, "access_denied", "rejected"), (0x97, "rate_limited", "rejected"), (0x80, "device_failure", "unknown")],
)
@pytest.mark.parametrize("qos", [1, 2])
def test_a_message_that_the_broker_refuses_is_a_failure(
    adapter: Any, broker: Any, qos: int, reason: int, code: str, outcome: str
) -> None:
    broker.fault({"packet": "PUBLISH", "client_id": CLIENT, "times": 1, "action": {"reason_code": reason}})
    reply = publish(adapter, "a", qos=qos)
    told = ("protocol_error", "unknown") if qos == 2 else (code, outcome)
    assert (reply.error["code"], reply.error["outcome"], reply.error["details"]["by"]) == (*told, "device")
    # Nothing is wrong with the connection.
    assert publish(adapter, "a", qos=qos).meta["connection"] == reply.meta["connection"]


@contextlib.contextmanager
def impostor(answers: list[bytes]) -> Iterator[int]:
    """Run a server that answers whatever it receives with the last of these answers, and closes the connection."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            with contextlib.suppress(OSError):
                while True:
                    connection, _ = listener.accept()
                    with connection, contextlib.suppress(ConnectionError):
                        connection.recv(1000)
                        connection.sendall(answers[-1])

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield listener.getsockname()[1]
        finally:
            listener.shutdown(socket.SHUT_RDWR)
            thread.join()


def test_what_is_no_broker_is_told_and_nothing_is_published_to_it(rig: Any) -> None:
    answers = [b""]
    with impostor(answers) as port:
        fresh = rig.start("deceived", writes="true", MQTT_URL=f"mqtt://127.0.0.1:{port}")
        for answer, code in {
            b"": "connect_failed",
            b"HTTP/1.1 400 Bad Request\r\n\r\n": "connect_failed",
            b"\x20\x02\x00": "connect_failed",
            b"\x20\x02\x00\x01": "config_error",
            b"\x20\x02\x00\x63": "config_error",
            b"\x20\x03\x00\x63\x00": "config_error",
            b"\xff" * 9: "config_error",
        }.items():
            answers.append(answer)
            # This call may fail with an attempt that got the answer before; the next call then makes a new attempt.
            assert fresh.call("get_broker_info").error["code"] in (code, "connect_failed"), answer
            error = publish(fresh, "a").error
            assert (error["code"], error["outcome"]) == (code, "not_sent"), answer
        assert fresh.close()[0] == 0


@contextlib.contextmanager
def mute_broker() -> Iterator[tuple[socket.socket, int]]:
    """Open a listening socket and give it with its port; the test itself acts as the broker."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(PATIENCE_S)
        yield listener, listener.getsockname()[1]


def test_a_connection_that_was_given_up_is_reset_so_that_the_kernel_sends_nothing_more(rig: Any) -> None:
    with mute_broker() as (listener, port):
        fresh = rig.start("resetting", writes="true", MQTT_URL=f"mqtt://127.0.0.1:{port}")
        call = fresh.start("publish_message", {"topic": "a", "payload": "x", "qos": 1})
        connection, _ = listener.accept()
        with connection:
            connection.settimeout(PATIENCE_S)
            connection.recv(1000)
            connection.sendall(b"\x20\x03\0\0\0")
            assert connection.recv(1000)[0] == 0x32
            fresh.pass_time()
            with pytest.raises(ConnectionResetError):
                connection.recv(1000)
        assert refused(fresh.reply("publish_message", call)) == ("timeout", "unknown", False)
        fresh.close()


@pytest.mark.asyncio
async def test_a_connection_knows_its_end_before_the_loop_has_read_it() -> None:
    with mute_broker() as (listener, port):
        endpoint = Endpoint(
            host="127.0.0.1",
            port=port,
            tls=None,
            version="5",
            client_id="c",
            username=None,
            password=None,
            timeout_s=PATIENCE_S,
        )
        connection = Connection(endpoint, lambda message: None)
        opening = asyncio.create_task(connection.open(None))
        peer, _ = await asyncio.to_thread(listener.accept)
        with peer:
            peer.sendall(b"\x20\x03\0\0\0")
            await opening
            assert connection.is_live()
        # Loopback delivers the end at once or, on a busy machine, soon; the event loop does not run meanwhile.
        given_up = time.monotonic() + PATIENCE_S
        while connection.is_live() and time.monotonic() < given_up:
            pass
        assert not connection.is_live()
        with pytest.raises(Lost):
            connection.send(Message(topic="a", payload=b"x"))


def test_two_clients_with_one_identifier_do_not_throw_each_other_out_for_ever(rig: Any, broker: Any) -> None:
    mark = broker.mark()
    twins = [rig.start("twin", writes="true", MQTT_CLIENT_ID="twin") for _ in range(2)]
    for twin in twins:
        twin.call("get_broker_info")
    # The pauses start at a twentieth of a second and grow: the sixteenth CONNECT comes after two seconds.
    connects = broker.wait(mark, count=16, kind="CONNECT", direction="in", client_id="twin")
    pauses = [later["t_ns"] - earlier["t_ns"] for earlier, later in itertools.pairwise(connects)]
    assert max(pauses) > 0.35e9
    for twin in twins:
        twin.close()


# -- outages -----------------------------------------------------------------------------------------------------


def test_nothing_is_queued_over_an_outage_and_subscriptions_come_back_by_themselves(
    adapter: Any, rig: Any, broker: Any
) -> None:
    # The plant's topics are not used: after its start the plant may run for a second before it is paused.
    adapter.call("subscribe_topic", topic="probes/#", qos=1)
    generation = adapter.call("get_broker_info").meta["connection"]["generation"]
    broker("poke", params={"publish": {"topic": "probes/a", "payload": "b2xk"}})
    assert received(adapter, "probes/b") == []
    with rig.outage():
        for qos in (0, 1, 2):
            reply = publish(adapter, "stale", qos)
            assert refused(reply) == ("connect_failed", "not_sent", True)
            assert (reply.meta["attempts"], reply.meta["connection"]["state"]) == (0, "disconnected")
        assert adapter.call("get_broker_info").error["code"] == "connect_failed"
        assert adapter.call("subscribe_topic", topic="later/#").error["code"] == "connect_failed"
        # Arguments are checked without a broker.
        assert adapter.call("publish_message", topic="", payload="x").error["code"] == "invalid_input"
        listed = adapter.call("list_subscriptions")
        assert listed.data["subscriptions"] == [{"topic": "probes/#", "qos": 1, "granted_qos": 1, "active": False}]
        left = adapter.call("read_messages", topic="#").data
        assert ([one["payload"] for one in left["messages"]], left["connected"]) == (["old"], False)
    # The adapter reconnects by itself, without a call.
    (granted,) = broker.wait(0, kind="SUBACK", client_id=CLIENT)
    assert granted["reason_codes"] == [1]
    broker("poke", params={"publish": {"topic": "probes/a", "payload": "bmV3", "qos": 1}})
    assert received(adapter, "probes/#") == ["new"]
    reply = adapter.call("list_subscriptions")
    assert reply.data["subscriptions"] == [{"topic": "probes/#", "qos": 1, "granted_qos": 1, "active": True}]
    assert reply.meta["connection"]["generation"] == generation + 1
    assert sent(broker, 0, "PUBLISH") == []
    adapter.call("unsubscribe_topic", topic="probes/#")


def test_a_restored_subscription_that_is_refused_is_shown_as_inactive(adapter: Any, broker: Any) -> None:
    adapter.call("subscribe_topic", topic="lost/#")
    mark = broker.mark()
    broker.fault(
        {"packet": "UNSUBSCRIBE", "client_id": CLIENT, "times": 1, "action": {"close": True}},
        {"packet": "SUBSCRIBE", "client_id": CLIENT, "times": 1, "action": {"reason_code": 0x80}},
    )
    adapter.call("get_broker_info")
    assert len(sent(broker, mark, "SUBSCRIBE")) == 1
    (listed,) = adapter.call("list_subscriptions").data["subscriptions"]
    assert listed == {"topic": "lost/#", "qos": 0, "granted_qos": None, "active": False}
    adapter.call("unsubscribe_topic", topic="lost/#")


def test_a_message_right_after_the_brokers_end_does_not_succeed(adapter: Any, rig: Any, broker: Any) -> None:
    for _ in range(3):
        adapter.call("get_broker_info")
        with rig.outage():
            # QoS 0 has no answer: only a look at the connection before writing shows that it has ended.
            assert refused(publish(adapter, "into the void", 0))[:2] == ("connect_failed", "not_sent")
        back(broker, 0)
        assert publish(adapter, "back", 0).meta["connection"]["state"] in ("connected", "reconnected")


def test_a_birth_that_failed_in_an_outage_has_not_happened(rig: Any, broker: Any) -> None:
    client = "mqtt-tests-early"
    with rig.outage():
        fresh = rig.start("early", writes="true")
        metrics = [{"name": "m", "datatype": "Int8", "value": 1}]
        birth = fresh.call("publish_device_birth", device_id="d", metrics=metrics)
        assert refused(birth) == ("connect_failed", "not_sent", True)
    back(broker, 0, client)
    data = fresh.call("publish_device_data", device_id="d", metrics=[{"name": "m", "value": 1}])
    assert data.error["code"] == "not_born"
    fresh.call("get_broker_info")
    assert broker.since(0, kind="PUBLISH", direction="in", client_id=client) == []
    mark = broker.mark()
    assert fresh.close()[0] == 0
    # The adapter sends DISCONNECT, so the broker discards the will.
    broker.wait(mark, kind="DISCONNECTED", client_id=client)
    assert broker.since(mark, kind="DISCONNECT", client_id=client)
    assert broker.since(mark, kind="WILL", client_id=client) == []
