"""MQT: publishing and subscribing."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.journal import Entries
from pytest_otmcp.protocols.mqtt import oracle
from pytest_otmcp.protocols.mqtt.entries import adapter_packets, messages, payload_of
from pytest_otmcp.protocols.mqtt.inbox import listed
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from ..commanded import some_command
from ..tasks.common import UNCERTAIN, outages_show
from ..tasks.messages import collect, publish_from_kit, subscribe, sync_point, tells_topics
from .mqtt_steps import nonce, speaks_mqtt_5, until, until_it_works
from .steps import CONNECTION_FAULTS, answers_again, citing, exercise, since, some_read

__all__ = ["TASKS"]

TASKS = Checks()

_PUMP = "control/pump"
_CAPITALS = "control/Pump/A"
_LATE_S = 0.2
"""Seconds by which an acknowledgement is late: well above a tick of the coarsest clock, well below every timeout."""

_NOT_AUTHORIZED = 0x87
_REFUSED = ("access_denied", "protocol_error", "device_failure")
"""Some libraries go on with a message of QoS 2 that was refused, and lose the reason: the broker does not know its identifier any more."""

_NOTICING_S = 1.0
"""Seconds for which a publication may still be handed to a connection that has just been cut."""

_BURST = 5200
_MOST_READS = 120

# -- MQT-001 ------------------------------------------------------------------------------------------------


@TASKS.check("MQT-001", "A publication is a success when the broker has acknowledged it.", needs="mqtt.publish")
async def a_publication_is_acknowledged(run: Repetition, mqtt: Rig) -> None:
    """Publish with QoS 1 and 2 while the broker acknowledges late, and the same message again; while it ends the connection instead; with QoS 1 while it says
    nothing; in MQTT 5 with QoS 1 and 2 while it refuses the message; and with QoS 0 while it is away. Then publish again. A subject that
    publishes by named commands alone is asked for one of them while the broker acknowledges late, ends the connection and says nothing.

    Said: success after the acknowledgement; failures of the connection with the outcome `unknown` or `not_sent`; a failure; success.
    Seen: for each success with QoS 1 the PUBACK, with QoS 2 the PUBCOMP, before the reply; the message itself once.
    Why: a library takes a message and says "fine" long before a broker has it, or never gets rid of it.
    """
    if mqtt.by_command_alone("publish"):
        await _commands_are_acknowledged(run, mqtt)
        return
    for qos in _every_qos(mqtt):
        await mqtt.device.fault({"packet": "PUBLISH", "action": {"delay_s": _LATE_S}})
        payload, reply = await _publish(run, mqtt, qos)
        await mqtt.device.fault()
        run.succeeds(reply, requirement="MQT-001")
        run.witnessed(_acknowledged(reply, await mqtt.journal(), payload))
        granted = mqtt.subject.expected_if_accepted("publish", "qos", qos)
        await _arrives(run, mqtt, reply, payload, qos=granted)
        again = await mqtt.call("publish", topic=_PUMP, payload=payload.decode(), qos=qos)
        run.succeeds(again, requirement="MQT-001")
        await _arrives(run, mqtt, again, payload, qos=granted)
        await _unacknowledged(
            run, mqtt, qos, {"packet": "PUBREL" if qos == 2 else "PUBLISH", "action": {"reset": True}}
        )
    entries = await _unacknowledged(run, mqtt, 1, {"packet": "PUBLISH", "action": {"no_answer": True}})
    if speaks_mqtt_5(entries):
        for qos in _every_qos(mqtt):
            await _refused(run, mqtt, qos)
    # While the broker is away nothing is published by an adapter that may have gone over to another one.
    if mqtt.subject.claims("recovery") and outages_show(mqtt):
        await _nobody_is_there(run, mqtt)


async def _commands_are_acknowledged(run: Repetition, mqtt: Rig) -> None:
    for action in ({"delay_s": _LATE_S}, {"reset": True}, {"no_answer": True}):
        await mqtt.device.fault({"packet": "PUBLISH", "action": action})
        asked = some_command(run, mqtt)
        reply = await mqtt.call(asked.operation, **asked.inputs)
        await mqtt.device.fault()
        entries = await mqtt.journal()
        for message in exercise(mqtt).done(since(reply, entries), asked)[:1]:
            run.witnessed(_acknowledged(reply, entries, payload_of(message)))
        if "delay_s" in action:
            run.succeeds(reply, requirement="MQT-001")
        elif not reply.success:
            run.fails(reply, *CONNECTION_FAULTS, outcome=UNCERTAIN, requirement="MQT-001", code_requirement="ERR-005")
        reading = exercise(mqtt).read(run.rng)
        if mqtt.can_ask(reading.operation, reading.inputs):
            await answers_again(run, mqtt)
        else:
            await mqtt.fresh_session()


def _every_qos(mqtt: Rig) -> tuple[int, ...]:
    if not mqtt.subject.accepts_input("publish", "qos"):
        return (1,)
    return tuple(qos for qos in (1, 2) if mqtt.excess("publish", topic=_PUMP, payload="", qos=qos) is None)


async def _publish(run: Repetition, mqtt: Rig, qos: int) -> tuple[bytes, Reply]:
    payload = f"check-{nonce(run)}"
    return payload.encode(), await mqtt.call("publish", topic=_PUMP, payload=payload, qos=qos)


def _acknowledged(reply: Reply, entries: Entries, payload: bytes) -> list[Finding]:
    received_ns = reply.exchange.received_ns
    if not reply.success or received_ns is None:
        return []
    return oracle.acknowledged(since(reply, entries), payload, received_ns=received_ns)


async def _arrives(
    run: Repetition,
    mqtt: Rig,
    reply: Reply,
    payload: bytes,
    *,
    qos: int | None,
    retain: bool = False,
    topic: str = _PUMP,
) -> None:
    """Expect that the broker received the message of a call that succeeded, once, and as it was asked for."""
    if not reply.success:
        return
    await until(mqtt, lambda entries: any(payload_of(packet) == payload for packet in messages(since(reply, entries))))
    run.witnessed(
        oracle.published_once(
            since(reply, await mqtt.journal()),
            topic=topic,
            payload=payload,
            qos=qos,
            retain=retain,
            declared=mqtt.subject.declared,
        )
    )


async def _unacknowledged(run: Repetition, mqtt: Rig, qos: int, rule: Mapping[str, object]) -> Entries:
    """Publish while the broker does not acknowledge; then it does again. Return what the broker has seen until the former."""
    await mqtt.device.fault(rule)
    payload, reply = await _publish(run, mqtt, qos)
    await mqtt.device.fault()
    entries = await mqtt.journal()
    run.witnessed(_acknowledged(reply, entries, payload))
    if not reply.success:
        run.fails(reply, *CONNECTION_FAULTS, outcome=UNCERTAIN, requirement="MQT-001", code_requirement="ERR-005")
    asked = some_read(run, mqtt) or Asked(
        operation="publish", inputs={"topic": _PUMP, "payload": f"again-{nonce(run)}", "qos": 0}
    )
    for poke in asked.pokes:
        await mqtt.device.poke(**poke)
    await until_it_works(run, mqtt, asked.operation, **asked.inputs)
    return entries


async def _refused(run: Repetition, mqtt: Rig, qos: int) -> None:
    """Publish while the broker refuses the message."""
    await mqtt.device.fault({"packet": "PUBLISH", "action": {"reason_code": _NOT_AUTHORIZED}})
    _, reply = await _publish(run, mqtt, qos)
    await mqtt.device.fault()
    if oracle.refusals(reply.during(await mqtt.journal())):
        run.fails(reply, *_REFUSED, outcome=("rejected", "unknown"), requirement="MQT-001", code_requirement="ERR-004")


async def _nobody_is_there(run: Repetition, mqtt: Rig) -> None:
    """Publish with QoS 0 while the broker is stopped, and when it is back."""
    await mqtt.stop_device()
    payload = f"lost-{nonce(run)}"
    reply = await mqtt.call_until_failure("publish", window_s=_NOTICING_S, topic=_PUMP, payload=payload, qos=0)
    run.fails(reply, *CONNECTION_FAULTS, outcome=UNCERTAIN, requirement="MQT-001", code_requirement="ERR-005")
    await mqtt.start_device()
    asked: dict[str, Any] = {"topic": _PUMP, "payload": f"back-{nonce(run)}", "qos": 0}
    replies = await mqtt.call_until_success("publish", window_s=mqtt.subject.recovery_s, **asked)
    run.succeeds(replies[-1], requirement="REC-001")


# -- MQT-002 ------------------------------------------------------------------------------------------------


@TASKS.check("MQT-002", "A subscription is a success when the broker has granted it.", needs="mqtt.subscribe")
async def a_subscription_is_granted(run: Repetition, mqtt: Rig) -> None:
    """Subscribe while the broker refuses the filter; the same when it does not; while it grants a lower quality of service; and while
    it says nothing. End the subscription.

    Said: `access_denied`; success; success with the quality of service that was granted; a failure of the connection; success.
        A filter that was refused is not listed as active.
    Seen: the filter is granted, and a message is sent to the adapter; after the end it is subscribed no more.
    Why: who waits for the alarms of a subscription that was refused takes the silence for good news.
    """
    refused, lower, silent = (f"otmcp/{nonce(run)}" for _ in range(3))
    await mqtt.device.fault({"packet": "SUBSCRIBE", "topic": refused, "action": {"reason_code": 0x80}})
    reply = await mqtt.call("subscribe", filter=refused, qos=0)
    run.fails(reply, "access_denied", "device_failure", requirement="MQT-002", code_requirement="ERR-001")
    await _is_not_listed(run, mqtt, refused)
    await mqtt.device.fault()
    run.succeeds(await subscribe(mqtt, refused))
    run.witnessed((await mqtt.follow(oracle.Subscriptions)).granted(refused, qos=None))
    payload = nonce(run).encode()
    await publish_from_kit(mqtt, refused, payload)
    await mqtt.wait_for(kind="PUBLISH", direction="out", topic=refused, timeout_s=1.0)
    run.witnessed(citing("MQT-002", oracle.delivered(await mqtt.journal(), topic=refused, payload=payload)))
    if mqtt.subject.accepts_input("subscribe", "qos"):
        await mqtt.device.fault({"packet": "SUBSCRIBE", "topic": lower, "action": {"reason_code": 0}})
        run.succeeds(await mqtt.call("subscribe", filter=lower, qos=1), granted_qos=0)
    if mqtt.subject.claims("unsubscribe"):
        run.succeeds(await mqtt.call("unsubscribe", filter=refused))
        run.witnessed((await mqtt.follow(oracle.Subscriptions)).ended(refused))
    await mqtt.device.fault({"packet": "SUBSCRIBE", "topic": silent, "action": {"no_answer": True}})
    reply = await mqtt.call("subscribe", filter=silent, qos=0)
    await mqtt.device.fault()
    run.fails(reply, *CONNECTION_FAULTS, requirement="MQT-002", code_requirement="ERR-005")
    await until_it_works(run, mqtt, "subscribe", filter=silent, qos=0)


async def _is_not_listed(run: Repetition, mqtt: Rig, refused: str) -> None:
    """Expect that a refused filter is not among the subscriptions, unless it is said not to be active."""
    if not mqtt.subject.claims("subscriptions"):
        return
    reply = await mqtt.call("subscriptions")
    if not run.succeeds(reply):
        return
    filters, active = (reply.outputs.get(name) for name in ("filters", "active"))
    if not isinstance(filters, list) or refused not in filters:
        return
    place = filters.index(refused)
    if isinstance(active, list) and len(active) > place and active[place] is False:
        return
    message = (
        f"{reply.label}: {refused!r}, which the broker refused, should not be listed as a subscription that is active"
    )
    run.judge(reply, [Finding(code="wrong_value", message=message, requirement="MQT-002")])


# -- MQT-003 ------------------------------------------------------------------------------------------------


@TASKS.check("MQT-003", "A message arrives with the payload and the flags that were asked for.", needs="mqtt.publish")
async def a_message_arrives_as_it_was_asked_for(run: Repetition, mqtt: Rig) -> None:
    """Publish with each quality of service, retained and not; on a topic with capitals; a text of several scripts, a long one, none, and,
    where the tool takes them, bytes that are no text. Receive one message that is retained, and one that is not.

    Said: success. For the two messages, which of them was retained.
    Seen: each message once, with its payload, its quality of service and its retain flag; none is retained unless that was asked for.
    Why: a retained command is carried out again whenever the machine connects.
    """
    # The Remaining Length of the long one has three bytes.
    for qos, text in (
        (0, "22,5 °C \N{GREEK CAPITAL LETTER OMEGA} 圧力 "),
        (1, '"quoted" \\ '),
        (2, "x" * 20_000),
        (0, ""),
    ):
        payload = text + nonce(run) if text else text
        await _publishes(run, mqtt, *_allowed(mqtt, payload, qos))
    payload = f"capitals-{nonce(run)}"
    await _publishes(run, mqtt, payload, payload.encode(), topic=_CAPITALS)
    if mqtt.subject.accepts_input("publish", "encoding"):
        binary = run.rng.randbytes(8) + bytes(reversed(range(256)))
        while mqtt.excess("publish", topic=_PUMP, payload=base64.b64encode(binary).decode()) and len(binary) > 1:
            binary = binary[: len(binary) // 2]
        await _publishes(run, mqtt, base64.b64encode(binary).decode(), binary, encoding="base64")
    if mqtt.subject.accepts_input("publish", "retain"):
        for retain in (True, False):
            payload = f"retain-{nonce(run)}"
            await _publishes(run, mqtt, payload, payload.encode(), retain=retain)
        await mqtt.device.poke(publish={"topic": _PUMP, "payload": "", "retain": True})
    if (
        mqtt.subject.claims("messages.retained")
        and mqtt.subject.claims("subscribe")
        and not mqtt.subject.blocks("messages")
    ):
        await _flags_what_was_retained(run, mqtt)


def _allowed(mqtt: Rig, payload: str, qos: int) -> tuple[str, bytes, int]:
    """Return a payload as text and as bytes, and a quality of service, as far as the schema of the tool allows them."""
    while mqtt.excess("publish", topic=_PUMP, payload="", qos=qos) is not None and qos:
        qos -= 1
    while mqtt.excess("publish", topic=_PUMP, payload=payload, qos=qos) is not None and len(payload) > 1:
        payload = payload[len(payload) // 2 :]
    return payload, payload.encode(), qos


async def _publishes(
    run: Repetition,
    mqtt: Rig,
    payload: str,
    expected: bytes,
    qos: int = 1,
    *,
    topic: str = _PUMP,
    retain: bool = False,
    **inputs: Any,
) -> None:
    asked: dict[str, Any] = {"retain": True} if retain else {}
    reply = await mqtt.call("publish", topic=topic, payload=payload, qos=qos, **asked, **inputs)
    run.succeeds(reply, topic=topic)
    accepted = mqtt.subject.expected_if_accepted("publish", "qos", qos)
    await _arrives(run, mqtt, reply, expected, qos=accepted, retain=retain, topic=topic)


async def _flags_what_was_retained(run: Repetition, mqtt: Rig) -> None:
    topic = f"otmcp/{nonce(run)}"
    kept, fresh = nonce(run), nonce(run)
    encoded = base64.b64encode(kept.encode()).decode()
    await mqtt.device.poke(publish={"topic": topic, "payload": encoded, "retain": True})
    run.succeeds(await subscribe(mqtt, topic))
    await publish_from_kit(mqtt, topic, fresh.encode())
    await sync_point(run, mqtt, topic)
    reply = await mqtt.call("messages", filter=topic)
    await mqtt.device.poke(publish={"topic": topic, "payload": "", "retain": True})
    if not run.succeeds(reply):
        return
    flags = reply.outputs.get("retained")
    messages = listed(reply.outputs)
    told = dict(zip((one.content for one in messages), flags, strict=False)) if isinstance(flags, list) else {}
    if [told.get(kept.encode()), told.get(fresh.encode())] != [True, False]:
        payloads = [one.payload for one in messages]
        message = f"{reply.label}: the first message was retained, the second was not, the reply says {flags!r} of {payloads!r}"
        run.judge(reply, [Finding(code="wrong_value", message=message, requirement="MQT-003")])


# -- MQT-004 ------------------------------------------------------------------------------------------------


@TASKS.check("MQT-004", "What a wildcard brought can be read back, and what is lost is counted.", needs="mqtt.receive")
async def what_a_wildcard_brought_can_be_read(run: Repetition, mqtt: Rig) -> None:
    """Subscribe to a filter with a wildcard; the kit publishes messages on several topics, some of which have capitals: equal ones in a row,
    and one with bytes that are no text. Read them by the filter, by another wildcard and by a topic. Where the tool says how many messages it has dropped, publish 5200
    at once and read them all.

    The session is a new one.

    Said: each message once, on its own topic, in the order of its topic. Of the 5200, those that are not read are counted.
    Seen: the broker sends every message to the adapter.
    Why: an inbox that finds nothing by a wildcard, or forgets in silence, makes an alarm disappear.
    """
    if not tells_topics(mqtt):
        run.not_applicable(
            "the messages that the subject returns have no topics: what a wildcard brought cannot be told apart"
        )
    if mqtt.subject.blocks("messages"):
        await collect(run, mqtt, {f"otmcp/{name}/#": (f"otmcp/{name}/a", nonce(run)) for name in (nonce(run),)})
        return
    # Messages that earlier checks have left would be dropped, and counted, as well.
    await mqtt.fresh_session()
    base = f"otmcp/{nonce(run)}"
    run.succeeds(await subscribe(mqtt, f"{base}/#"))
    for text, parts in (
        (f"{base}/#", ("a", "B/Deep", "c")),
        (f"{base}/+/end", ("d/end", "e/end")),
        (f"{base}/f", ("f",)),
    ):
        topics = [f"{base}/{part}" for part in parts]
        sent = [(topics[index % len(topics)], f"{index}-{nonce(run)}") for index in range(6)]
        # A second reading may be equal to the first one; so may what another topic says.
        sent += [sent[-1], (topics[0], sent[-1][1])]
        for topic, payload in sent:
            await publish_from_kit(mqtt, topic, payload.encode())
        await sync_point(run, mqtt, f"{base}/#")
        reply = await mqtt.call("messages", filter=text)
        if run.succeeds(reply):
            run.judge(reply, _read_back(reply, sent))
    await _bytes_are_kept(run, mqtt, base)
    if mqtt.subject.claims("messages.dropped"):
        await _what_is_lost_is_counted(run, mqtt, base)


def _read_back(reply: Reply, sent: Sequence[tuple[str, str]]) -> list[Finding]:
    """Expect each of these messages once, on its topic, and those of one topic in their order."""
    expected = [(topic, payload.encode()) for topic, payload in sent]
    payloads = {payload for _, payload in expected}
    found = [(message.topic, message.content) for message in listed(reply.outputs)]
    mine = [one for one in found if one[1] in payloads]
    problem = None
    if sorted(mine, key=repr) != sorted(expected, key=repr):
        there = sum(one in mine for one in expected)
        problem = f"of {len(sent)} messages {there} are there as they came, and {len(mine)} in all"
    elif any(
        [one for one in mine if one[0] == topic] != [one for one in expected if one[0] == topic] for topic, _ in sent
    ):
        problem = "the messages of a topic are not in the order in which they came"
    if problem is None:
        return []
    message = f"{reply.label}: each message should be there once, on its topic and in order; {problem}"
    return [Finding(code="wrong_value", message=message, requirement="MQT-004", evidence=repr(found)[:400])]


async def _bytes_are_kept(run: Repetition, mqtt: Rig, base: str) -> None:
    topic, content = f"{base}/binary", b"\xff\xfe\x00" + run.rng.randbytes(8)
    await publish_from_kit(mqtt, topic, content)
    await sync_point(run, mqtt, f"{base}/#")
    reply = await mqtt.call("messages", filter=topic)
    if not run.succeeds(reply):
        return
    found = [message for message in listed(reply.outputs) if message.topic == topic]
    message = None
    if len(found) != 1:
        message = f"{reply.label}: the message with bytes that are no text should be there once, it is there {len(found)} times"
    elif found[0].base64 and found[0].content != content:
        message = f"{reply.label}: the payload should be {content!r} in base64, the reply says {found[0].payload!r}"
    if message is not None:
        run.judge(reply, [Finding(code="wrong_value", message=message, requirement="MQT-004")])


async def _what_is_lost_is_counted(run: Repetition, mqtt: Rig, base: str) -> None:
    """Publish more messages at once than an inbox may be expected to keep, and compare what is read with what is said to be lost."""
    topic = f"{base}/burst"
    before = await mqtt.call("messages", filter=topic)
    if not run.succeeds(before):
        return
    await mqtt.device.poke(burst={"topic": topic, "count": _BURST, "brief": True})
    bursts = [one for one in adapter_packets(await mqtt.journal(), "BURST", "out") if one["topic"] == topic]
    # An adapter with several connections may have been sent them more than once, one whose connection ended not all of them.
    sent = min(_BURST, sum(one["count"] for one in bursts))
    await sync_point(run, mqtt, f"{base}/#")
    read: set[bytes | None] = set()
    counts = [before.outputs.get("dropped")]
    for _ in range(_MOST_READS):
        reply = await mqtt.call("messages", role="control", filter=topic)
        if not run.succeeds(reply):
            return
        counts.append(reply.outputs.get("dropped"))
        new = {message.content for message in listed(reply.outputs)} - read
        read |= new
        if not new:
            break
    # Messages on other topics may have been dropped as well.
    others = len(adapter_packets(await mqtt.session_journal(), "PUBLISH", "out"))
    missing = sent - len(read)
    if not any(missing <= lost <= missing + others for lost in _lost(counts)):
        message = f"{reply.label}: of {sent} messages {len(read)} can be read, said to be dropped are {sum(one for one in counts[1:] if isinstance(one, int))}"
        run.judge(reply, [Finding(code="wrong_value", message=message, requirement="MQT-004")])


def _lost(counts: Sequence[object]) -> set[int]:
    """Return how many messages are said to be dropped after the first answer; a count begins at the last reading, or at the start."""
    numbers = [count for count in counts if isinstance(count, int)]
    return {sum(numbers[1:]), numbers[-1] - numbers[0]} if len(numbers) == len(counts) else set()
