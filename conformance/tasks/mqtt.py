"""The tasks on MQTT and Sparkplug B.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
broker. Values are different in every repetition, so that no cached or mixed-up answer can pass.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable
from functools import partial
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.mqtt import oracle
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Tasks

from ..commanded import carried_out, nothing_sent, some_command
from .common import (
    QUIET_S,
    RAPID_CALLS,
    Witness,
    a_delay_shows,
    a_meaningless_switch_enables_nothing,
    ends_when_its_stdin_closes,
    nothing_is_made_up_for,
    outage,
    start_without_device,
    status_is_known,
    survive_a_restart,
    untold,
    writes_fail,
)
from .messages import arrival, collect, publish_from_kit, receives, subscribe, sync_point, tells, tells_topics
from .refusals import filters_are_no_topics

__all__ = ["TASKS"]

TASKS = Tasks()


@TASKS.task(
    "Q1",
    "normal",
    "Inspect broker connectivity through the MCP adapter.",
    needs="mqtt.info",
    capability="reading",
    requirements="REC-002",
)
async def broker_info(run: Repetition, mqtt: Rig) -> None:
    """Ask for the state of the connection to the broker.

    Said: success, and that the adapter is connected.
    Seen: the broker answers at least one packet during the call.
    Why: a status from memory still says "connected" when the broker is gone.
    """
    reply = await mqtt.call("info")
    run.succeeds(reply, connected=True)
    await status_is_known(run, mqtt, oracle.exchange, reply)


@broker_info.after
async def a_slow_device_is_reported_as_slow(run: Repetition, mqtt: Rig) -> None:
    """Ask for the state while the broker answers a tenth of a second late.

    Said: success, and a latency that is no shorter than that.
    """
    await a_delay_shows(run, mqtt, "info")


@TASKS.task(
    "Q2",
    "normal",
    "Subscribe to the mock sensor topic namespace.",
    needs="mqtt.receive",
    capability="reading",
    requirements="MQT-002 MQT-004",
)
async def subscribe_to_sensors(run: Repetition, mqtt: Rig) -> None:
    """Subscribe to a filter with a wildcard; the kit then publishes a message.

    Said: success, with the quality of service that was granted.
    Seen: a subscription that the broker granted and that lives; the message is sent to the adapter.
    Why: an adapter that calls a refused subscription a success waits for ever for its alarm.
    """
    if mqtt.subject.blocks("messages"):
        nonce = f"nonce-{run.rng.getrandbits(64):016x}"
        text = "sensors/#" if tells_topics(mqtt) else "sensors/temperature"
        await collect(run, mqtt, {text: ("sensors/temperature", nonce)})
        return
    reply = await subscribe(mqtt, "sensors/#")
    run.succeeds(reply, granted_qos=0)
    qos = mqtt.subject.expected_if_accepted("subscribe", "qos", 0)
    # An adapter that has the subscription already need not ask for it again.
    run.witnessed((await mqtt.follow(oracle.Subscriptions)).granted("sensors/#", qos=qos))
    topic, payload = "sensors/temperature", f"nonce-{run.rng.getrandbits(64):016x}".encode()
    await publish_from_kit(mqtt, topic, payload)
    await mqtt.wait_for(kind="PUBLISH", direction="out", topic=topic, timeout_s=1.0)
    run.witnessed(oracle.delivered(await mqtt.journal(), topic=topic, payload=payload))


@subscribe_to_sensors.after
async def a_received_message_can_be_read(run: Repetition, mqtt: Rig) -> None:
    """Ask for the messages that came; where messages have no topics, for those on a topic of its own that is subscribed to first.

    Said: the message with random content that the kit published, once and on its own topic.
    """
    if mqtt.subject.blocks("messages"):
        return
    # By the filter of the subscription and by the topic: of the first there may be older messages as well.
    topic, filters = "sensors/pressure", ["sensors/#", "sensors/pressure"]
    if not tells_topics(mqtt):
        # A broker may send a message once for each subscription that selects it (MQTT 3.1.1, section 3.3.5).
        topic, filters = "plant/pressure", ["plant/pressure"]
        run.succeeds(await subscribe(mqtt, topic))
    for text in filters:
        nonce = f"nonce-{run.rng.getrandbits(64):016x}"
        payload = base64.b64encode(nonce.encode()).decode()
        await publish_from_kit(mqtt, topic, nonce.encode())
        await mqtt.wait_for(kind="PUBLISH", direction="out", topic=topic, payload=payload, timeout_s=1.0)
        await sync_point(run, mqtt, "sensors/#")
        reply = await mqtt.call("messages", filter=text)
        receives(run, mqtt, reply, topic, nonce, by_topic=text == topic)


@TASKS.task(
    "Q3",
    "normal",
    "Publish a standard MQTT control payload.",
    needs="mqtt.publish",
    capability="writing",
    guards="mqtt",
    requirements="MQT-001 MQT-003 WR-003 WR-004 WR-005",
)
async def publish_control(run: Repetition, mqtt: Rig) -> None:
    """Publish a command, or call a named one where the subject publishes by these alone.

    Said: success, the topic, and that QoS 0 is not acknowledged.
    Seen: this message once, as it was asked for, and no second one.
    Why: a command that is lost or sent twice is a movement that nobody ordered.
    """
    if mqtt.by_command_alone("publish"):
        await carried_out(run, mqtt, some_command(run, mqtt))
        return
    payload = json.dumps({"pump_speed": 50 + run.rep})
    reply = await mqtt.call("publish", topic="control/pump", payload=payload, qos=0)
    qos = mqtt.subject.expected_if_accepted("publish", "qos", 0)
    # An adapter that takes no QoS may have chosen one that is acknowledged.
    delivery = {"delivery": "unacknowledged"} if qos == 0 else {}
    run.succeeds(reply, topic="control/pump", **delivery)
    await mqtt.wait_for(kind="PUBLISH", direction="in", topic="control/pump", timeout_s=1.0)
    journal = await mqtt.journal()
    run.witnessed(
        oracle.published_once(
            journal, topic="control/pump", payload=payload.encode(), qos=qos, declared=mqtt.subject.declared
        )
    )


@publish_control.after
async def nothing_is_published_with_writes_disabled(run: Repetition, mqtt_ro: Rig | None) -> None:
    """Publish the same through the adapter that was started with writes disabled, and through one that was started with a write
    switch that means nothing.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`; the second may refuse to start instead.
    Seen: no command over the whole life of these sessions.
    """
    if mqtt_ro is not None and mqtt_ro.by_command_alone("publish"):
        asked = some_command(run, mqtt_ro)
        await guarded_publish(run, mqtt_ro, partial(nothing_sent, mqtt_ro), asked.operation, **asked.inputs)
        await a_meaningless_switch_enables_nothing(run, mqtt_ro, asked.operation, **asked.inputs)
        return
    witness = partial(oracle.not_published, payload=b"guarded", requirement="WR-004")
    command = {"topic": "control/pump", "payload": "guarded", "qos": 0}
    await guarded_publish(run, mqtt_ro, witness, "publish", **command)
    if mqtt_ro is not None:
        await a_meaningless_switch_enables_nothing(run, mqtt_ro, "publish", **command)


async def guarded_publish(
    run: Repetition, guarded: Rig | None, witness: Witness, operation: str, **inputs: Any
) -> None:
    if guarded is None:
        return
    run.fails(await guarded.call(operation, **inputs), "writes_disabled", outcome="not_sent", requirement="WR-004")
    # The refusal only proves the guard if the session reaches its broker; the same call works in the task itself.
    if guarded.subject.claims("info"):
        info = await guarded.call("info")
        run.succeeds(info)
        await status_is_known(run, guarded, oracle.exchange, info)
    await guarded.close_session()
    publications = await guarded.follow(oracle.Publications)
    run.witnessed(publications.guarded(guarded.subject.declared) or witness(await guarded.journal()))


@TASKS.task(
    "Q4",
    "normal",
    "Publish a Sparkplug B DDATA update for the mock device.",
    needs="mqtt.device_birth mqtt.device_data",
    capability="writing",
    guards="mqtt",
    requirements="WR-004 SPB-001 SPB-002 SPB-003 SPB-004",
)
async def publish_device_data(run: Repetition, mqtt: Rig) -> None:
    """Publish new data of a Sparkplug device.

    Said: success, with the number of metrics.
    Seen: one DDATA with this metric and value, in a session that keeps the rules for edge nodes: births first, one
        sequence, a will.
    Why: a host throws away what breaks the rules, and the adapter has said "published".
    """
    value = 20.0 + run.rep
    metrics = [{"name": "temperature", "value": value}]
    reply = await mqtt.call("device_data", device="device-1", metrics=metrics)
    run.succeeds(reply, metric_count=1)
    # The device was born before this repetition; by now its metrics may have no name but an alias.
    births = await mqtt.follow(oracle.Births)
    reported = partial(oracle.ddata_metric, device="device-1", name="temperature", value=value, births=births)
    await arrival(mqtt, reported)
    # That the edge node keeps one sequence is judged over the whole life of every session.
    run.witnessed(reported(await mqtt.journal()))


@publish_device_data.before
async def the_device_is_born(run: Repetition, mqtt: Rig) -> None:
    """Announce the device.

    Said: success.
    """
    metrics = [{"name": "temperature", "datatype": "Double", "value": 20.0}]
    run.succeeds(await mqtt.call("device_birth", device="device-1", metrics=metrics))


@publish_device_data.after
async def no_device_is_born_with_writes_disabled(run: Repetition, mqtt_ro: Rig | None) -> None:
    """Announce a device through the adapter that was started with writes disabled.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`.
    Seen: no command over the whole life of that session.
    """
    metrics = [{"name": "temperature", "datatype": "Double", "value": 20.0}]
    witness = partial(oracle.not_reported, device="device-1")
    await guarded_publish(run, mqtt_ro, witness, "device_birth", device="device-1", metrics=metrics)


TO_NOWHERE = json.dumps({"pump_speed": 50})


def nothing_to_nowhere(mqtt: Rig, requirement: str = "ADR-006") -> Witness:
    """Return the check that the message without a topic reached the broker in no form."""
    return partial(
        oracle.not_published, payload=TO_NOWHERE.encode(), declared=mqtt.subject.declared, requirement=requirement
    )


@TASKS.task(
    "FQ1",
    "fault",
    "Publish to empty topic string and expect a structured invalid-input error.",
    needs="mqtt.publish",
    capability="refusing",
    requirements="ADR-006 ERR-006 MCP-009",
)
async def publish_to_nowhere(run: Repetition, mqtt: Rig) -> None:
    """Publish on an empty topic.

    Said: a failure with `invalid_input` and the outcome `not_sent`.
    Seen: no PUBLISH, and a connection that stays up.
    Why: a broker ends the connection at such a packet, and every subscription with it.
    """
    reply = await mqtt.call("publish", topic="", payload=TO_NOWHERE, qos=0)
    run.fails(reply, "invalid_input", outcome="not_sent", requirement="ADR-006")
    journal = await mqtt.journal()
    requirement = untold(reply, "ADR-006")
    run.witnessed(nothing_to_nowhere(mqtt, requirement)(journal), oracle.session_stays_up(journal))


@publish_to_nowhere.after
async def a_proper_topic_is_accepted(run: Repetition, mqtt: Rig) -> None:
    """Publish on a proper topic; before that, on one with a wildcard and on one with a null character. Then end the session.

    Said: success; for the two others a failure with `invalid_input` and the outcome `not_sent`.
    Seen: the message, once, and nothing of the two others; the connection stays up. The process ends by itself.
    """
    await mqtt.stays_quiet(QUIET_S, nothing_to_nowhere(mqtt))
    await filters_are_no_topics(run, mqtt)
    run.succeeds(await mqtt.call("publish", topic="control/pump", payload="control", qos=0))
    await mqtt.wait_for(kind="PUBLISH", direction="in", topic="control/pump", timeout_s=1.0)
    qos = mqtt.subject.expected_if_accepted("publish", "qos", 0)
    journal = await mqtt.journal()
    run.witnessed(
        oracle.published_once(
            journal, topic="control/pump", payload=b"control", qos=qos, declared=mqtt.subject.declared
        )
    )
    await ends_when_its_stdin_closes(mqtt)


@TASKS.task(
    "FQ2",
    "fault",
    "Subscribe with invalid QoS (5) and expect a structured invalid-input error.",
    needs="mqtt.subscribe mqtt.subscribe.qos",
    capability="refusing",
    requirements="ADR-007",
    keys="mqtt.probes.bad_qos",
)
async def subscribe_with_qos_5(run: Repetition, mqtt: Rig) -> None:
    """Subscribe with a quality of service that does not exist.

    Said: a failure with `invalid_input`.
    Seen: no SUBSCRIBE, and a connection that stays up.
    Why: a value that is cut down in silence is not what was asked for.
    """
    reply = await mqtt.call("subscribe", filter="sensors/#", qos=mqtt.subject.probe("bad_qos"))
    run.fails(reply, "invalid_input", requirement="ADR-007")
    journal = await mqtt.journal()
    run.witnessed(oracle.not_subscribed(reply.during(journal), "sensors/#"), oracle.session_stays_up(journal))


@subscribe_with_qos_5.after
async def a_proper_qos_is_accepted(run: Repetition, mqtt: Rig) -> None:
    """Subscribe with QoS 1.

    Said: success.
    Seen: a subscription that the broker granted with QoS 1.
    """
    await mqtt.stays_quiet(QUIET_S, lambda entries: oracle.not_subscribed(entries, "sensors/#"))
    run.succeeds(await subscribe(mqtt, "sensors/#", qos=1), granted_qos=1)
    run.witnessed((await mqtt.follow(oracle.Subscriptions)).granted("sensors/#", qos=1))


@TASKS.task(
    "S2",
    "stress",
    "Four concurrent reads of received messages.",
    needs="mqtt.receive",
    capability="load",
    position=2,
    requirements="CON-001 MQT-004",
)
async def concurrent_message_reads(run: Repetition, mqtt: Rig) -> None:
    """Ask for the messages on four topics by four calls at the same time.

    Said: in each answer the message of its own topic, once; where the tool takes no filter, in one of them.
    Seen: four messages that the broker sends to the adapter.
    Why: a message on the wrong topic is a measurement of the wrong machine.
    """
    nonces = {f"stress/{i}": f"nonce-{run.rng.getrandbits(64):016x}" for i in range(4)}
    if mqtt.subject.blocks("messages"):
        await collect(run, mqtt, {topic: (topic, nonce) for topic, nonce in nonces.items()})
        return
    for topic, nonce in nonces.items():
        await publish_from_kit(mqtt, topic, nonce.encode())
    await mqtt.wait_for(kind="PUBLISH", direction="out", topic="stress/3", timeout_s=1.0)
    await sync_point(run, mqtt, "stress/#")
    replies = await run.together(*(mqtt.call("messages", filter=topic) for topic in nonces))
    for reply, (topic, nonce) in zip(replies, nonces.items(), strict=True):
        # Four calls without a filter ask for the same: the first one may have taken what there was.
        having = (
            None
            if mqtt.subject.accepts_input("messages", "filter")
            else next((one for one in replies if tells(one, nonce)), None)
        )
        if having is not None:
            run.succeeds(reply)
        receives(run, mqtt, having or reply, topic, nonce)
        if having is None and not tells_topics(mqtt):
            _holds_no_other(run, reply, topic, [other for other in nonces.values() if other != nonce])


def _holds_no_other(run: Repetition, reply: Reply, topic: str, others: Iterable[str]) -> None:
    """Expect that an answer without topics holds no message that came on another topic than the one that was asked for."""
    if strange := [other for other in others if tells(reply, other)]:
        message = (
            f"{reply.label}: the message {strange[0]!r} should not be there, it came on another topic than {topic!r}"
        )
        run.judge(reply, [Finding(code="wrong_value", message=message, requirement="MQT-004")])


@concurrent_message_reads.before
async def the_adapter_listens(run: Repetition, mqtt: Rig) -> None:
    """Subscribe to the topics; one by one where messages have no topics.

    Said: success.
    """
    if mqtt.subject.blocks("messages"):
        return
    for text in ("stress/#",) if tells_topics(mqtt) else (f"stress/{i}" for i in range(4)):
        run.succeeds(await subscribe(mqtt, text))


@TASKS.task(
    "S5",
    "stress",
    "Concurrent broker inspection and publish.",
    needs="mqtt.info mqtt.publish",
    capability="load",
    position=5,
    requirements="CON-004 WR-003",
)
async def concurrent_info_and_publish(run: Repetition, mqtt: Rig) -> None:
    """Ask for the state of the connection and publish a command at the same time.

    Said: connected, and success with the topic.
    Seen: the message once.
    Why: a lost or doubled command shows only under load.
    """
    payload = json.dumps({"pump_speed": 50 + run.rep, "nonce": run.rng.getrandbits(32)})
    info, message = await run.together(
        mqtt.call("info"),
        mqtt.call("publish", topic="control/pump", payload=payload, qos=0),
    )
    run.succeeds(info, connected=True)
    run.succeeds(message, topic="control/pump")
    await mqtt.wait_for(kind="PUBLISH", direction="in", topic="control/pump", timeout_s=1.0)
    qos = mqtt.subject.expected_if_accepted("publish", "qos", 0)
    journal = await mqtt.journal()
    run.witnessed(
        oracle.published_once(
            journal, topic="control/pump", payload=payload.encode(), qos=qos, declared=mqtt.subject.declared
        )
    )


@TASKS.task(
    "S8",
    "stress",
    "Fifty broker inspections in a row.",
    needs="mqtt.info",
    capability="load",
    position=8,
    requirements="CON-006",
)
async def rapid_broker_inspections(run: Repetition, mqtt: Rig) -> None:
    """Ask for the state of the connection fifty times, one call after the other.

    Said: connected, every time.
    Seen: the broker answers a packet during each call.
    Why: leaks, caches and connections that are used up show in a long series only.
    """
    replies = [await mqtt.call("info") for _ in range(RAPID_CALLS)]
    for reply in replies:
        run.succeeds(reply, connected=True)
    await status_is_known(run, mqtt, oracle.exchange, *replies)


@TASKS.task(
    "S11",
    "stress",
    "Broker restart between broker inspections.",
    needs="mqtt.any_read mqtt.recovery",
    capability="outages",
    position=11,
    requirements="REC-001 REC-002",
    keys="mqtt.recovery",
)
async def broker_restart(run: Repetition, mqtt: Rig) -> None:
    """Ask for the state of the connection; again after the broker was stopped; and again after it was started.

    Said: success; then a failure with `connect_failed`, `connection_lost` or `timeout`; then success in the same
        session.
    Seen: an exchange with the broker after it is back.
    Why: an outage of the broker must not need a person who restarts the adapter, and must not be hidden.
    """
    await survive_a_restart(run, mqtt)


@broker_restart.after
async def the_session_is_what_it_was(run: Repetition, mqtt: Rig) -> None:
    """Subscribe, publish while the broker is away, and ask for the state when it is back.

    Said: a failure for the message, success for the state.
    Seen: a message on the topic still reaches the adapter; nothing of the message that was reported as failed, now or as long as
    the session lives.
    """
    keeps = mqtt.subject.reconnects and mqtt.subject.claims("subscribe") and mqtt.subject.claims("messages")
    listens = keeps and not mqtt.subject.blocks("messages")
    if listens:
        run.succeeds(await subscribe(mqtt, "outage/state"), requirement="REC-001")
    if mqtt.subject.claims("device_birth"):
        # What is told of a device that was never announced may be refused for that.
        metrics = [{"name": "temperature", "datatype": "Double", "value": 20.0}]
        run.succeeds(await mqtt.call("device_birth", device="device-1", metrics=metrics))
    if not await writes_fail(run, mqtt):
        await mqtt.stop_device()
    await mqtt.start_device()
    await nothing_is_made_up_for(run, mqtt)
    if listens:
        await still_subscribed(run, mqtt)


async def still_subscribed(run: Repetition, mqtt: Rig) -> None:
    """Expect that the subscription of before the outage is one again."""
    topic, nonce = "outage/state", f"nonce-{run.rng.getrandbits(64):016x}"
    await arrival(
        mqtt,
        partial(oracle.not_granted, filter=topic),
        kind="SUBACK",
        direction="out",
        timeout_s=mqtt.subject.recovery_s,
    )
    await sync_point(run, mqtt, topic)
    await publish_from_kit(mqtt, topic, nonce.encode())
    await mqtt.wait_for(kind="PUBLISH", direction="out", topic=topic, timeout_s=1.0)
    run.witnessed(oracle.subscription_lost(await mqtt.journal(), topic=topic, payload=nonce.encode()))


@TASKS.task(
    "R-mqtt",
    "recovery",
    "Recover from a restart of the MQTT broker.",
    needs="mqtt.any_read",
    capability="outages",
    requirements="REC-001 REC-002 MCP-009",
    keys="mqtt.recovery",
)
async def recovery(run: Repetition, mqtt: Rig) -> None:
    """Ask for the state of the connection; again after the broker was stopped; then, after it was started, in the same
    session and in a fresh one with a new process.

    Said: success; a failure of the connection; success in both sessions.
    Seen: an exchange of both sessions with the broker, and no command.
    Why: how soon an outage is noticed, and how soon work goes on, decides what the adapter can be used for.
    """
    await outage(run, mqtt)


@recovery.after
async def the_adapter_starts_without_its_device(run: Repetition, mqtt: Rig) -> None:
    """Start the adapter while its broker is down, ask, and ask again when it is there.

    Said: a failure of the connection first, success then.
    """
    await start_without_device(run, mqtt)
