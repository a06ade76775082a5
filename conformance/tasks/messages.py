"""Two ways to receive messages: most adapters subscribe and are asked later, some have only a call that waits for messages."""

from __future__ import annotations

import asyncio
import base64
import json
import math
from collections.abc import Callable, Mapping
from functools import partial

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.journal import Entries
from pytest_otmcp.protocols.mqtt import oracle
from pytest_otmcp.protocols.mqtt.inbox import listed
from pytest_otmcp.trial.expectations import succeeded
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

__all__ = [
    "arrival",
    "collect",
    "publish_from_kit",
    "received",
    "receives",
    "subscribe",
    "sync_point",
    "tells",
    "tells_topics",
]

COLLECT_S = 2
"""Seconds that a call that waits for messages is told to wait, on a machine that is not slow."""

MOST_AWAITED = 100
"""Packets that may come before the awaited one."""

SUBSCRIBING_S = 4.0
"""Seconds that such a call has to subscribe; a message that is published earlier cannot be received."""

SETTLING_S = 0.25
"""Seconds in which an adapter reads what it was sent, where none of its calls shows that it has."""

Messages = Mapping[str, tuple[str, str]]


async def publish_from_kit(mqtt: Rig, topic: str, payload: bytes, *, qos: int = 0) -> None:
    """Let the broker publish a message of the kit that is not retained."""
    message = {"topic": topic, "payload": base64.b64encode(payload).decode(), "qos": qos, "retain": False}
    await mqtt.device.poke(publish=message)


async def collect(run: Repetition, mqtt: Rig, messages: Messages) -> list[Reply]:
    """Ask for the messages on several topic filters at once, and publish one for each as soon as its filter is granted.

    An adapter that performs one call after the other has the next filter granted when the first call is over.

    Args:
        messages: topic filter to topic and payload.
    """
    # A slow machine also subscribes slowly, and that time may count as waiting.
    seconds = math.ceil(COLLECT_S * max(1.0, run.time_scale))

    async def publish() -> None:
        waiting = dict(messages)
        for count in range(1, MOST_AWAITED + 1):
            soon = SUBSCRIBING_S + (seconds if count > 1 else 0)
            granted = await mqtt.wait_for(kind="SUBACK", direction="out", count=count, timeout_s=soon)
            if len(granted) < count:
                return
            journal = await mqtt.journal()
            # Filters that are not the ones asked for are told apart by their number alone.
            ready = [text for text in waiting if count >= len(messages) or not oracle.not_granted(journal, filter=text)]
            for topic, payload in map(waiting.pop, ready):
                await publish_from_kit(mqtt, topic, payload.encode())
            if not waiting:
                return

    calls = (mqtt.call("messages", filter=text, seconds=seconds) for text in messages)
    publishing = asyncio.create_task(publish())
    try:
        replies = await run.together(*calls)
    finally:
        # Also when there was no reply: no message may be published during the next repetition.
        await publishing
    for reply, (topic, payload) in zip(replies, messages.values(), strict=True):
        receives(run, mqtt, reply, topic, payload)
    return replies


async def arrival(
    mqtt: Rig,
    missing: Callable[[Entries], list[Finding]],
    *,
    kind: str = "PUBLISH",
    direction: str = "in",
    timeout_s: float = 1.0,
) -> None:
    """Wait until the journal has what is looked for; other packets of this kind may come before it."""
    for seen in range(1, MOST_AWAITED + 1):
        if not missing(await mqtt.journal()):
            return
        if len(await mqtt.wait_for(kind=kind, direction=direction, count=seen, timeout_s=timeout_s)) < seen:
            return


async def subscribe(mqtt: Rig, filter: str, *, qos: int = 0, control: bool = False) -> Reply:
    """Subscribe, and wait until the broker has granted the filter.

    Some adapters say that they are subscribed as soon as their library has taken the request. MQT-002 judges that; a message that the kit
    publishes in the meantime would be lost by chance.

    Args:
        control: the call is the kit's own, and no part of the task.
    """
    reply = await mqtt.call("subscribe", role="control" if control else None, filter=filter, qos=qos)
    missing = partial(oracle.not_granted, filter=filter)
    # An adapter that has the subscription already need not ask for it again.
    if (
        reply.success
        and missing(await mqtt.journal())
        and (await mqtt.follow(oracle.Subscriptions)).granted(filter, qos=None)
    ):
        await arrival(mqtt, missing, kind="SUBACK", direction="out")
    return reply


async def sync_point(run: Repetition, mqtt: Rig, filter: str) -> None:
    """Perform an exchange on the adapter's connection: after it the adapter has read what the broker sent before.

    A state that is told from a cache is no exchange, and one that is asked for over another connection none on this one; the adapter then
    subscribes to a topic below the filter, on which nothing is published: to subscribe to the filter again would bring retained messages
    again, replace a subscription that was lost, or empty its buffer. Where no call waits for the broker, the adapter is
    left alone for a moment.
    """
    # A cache that is declared is renewed in its own time: an exchange during the call is not the call's.
    subscribes = mqtt.subject.claims("subscribe")
    if not subscribes or (mqtt.subject.claims("info") and mqtt.subject.max_age_s("info") is None):
        state = await mqtt.call("info", role="control")
        run.succeeds(state)
        if await _caught_up(mqtt, state):
            return
    if subscribes:
        subscribed = await subscribe(mqtt, f"{filter.removesuffix('/#')}/none", control=True)
        run.succeeds(subscribed)
        if await _caught_up(mqtt, subscribed):
            return
    await mqtt.watch(SETTLING_S)


async def _caught_up(mqtt: Rig, reply: Reply) -> bool:
    journal = await mqtt.journal()
    return oracle.caught_up(journal, reply.during(journal))


def receives(run: Repetition, mqtt: Rig, reply: Reply, topic: str, payload: str, *, by_topic: bool = True) -> None:
    """Expect that the message is among those that the adapter has received.

    Args:
        by_topic: asked for were the messages on this topic, not those that a wider filter selects.
    """
    filtered = by_topic and mqtt.subject.accepts_input("messages", "filter")
    run.judge(reply, received(reply, topic, payload, filtered=filtered, told=tells_topics(mqtt)))


def tells_topics(mqtt: Rig) -> bool:
    """Tell whether messages have their topics. Where they are payloads alone, they are asked for by one topic, and never by a wildcard."""
    return mqtt.subject.judges("messages.topic")


def received(reply: Reply, topic: str, payload: str, *, filtered: bool, told: bool = True) -> list[Finding]:
    """Expect that the answer holds the message with this payload once, on its topic.

    Args:
        filtered: only messages on this topic were asked for, so there must be no other message.
        told: messages have their topics.
    """
    if findings := succeeded(reply):
        return findings
    messages = listed(reply.outputs)
    found = [message for message in messages if message.content == payload.encode()]
    right = (topic,) if told else (topic, None)
    if len(found) == 1 and all(message.topic in right for message in (messages if filtered else found)):
        return []
    shown = json.dumps(reply.outputs.get("messages"), ensure_ascii=False, default=repr)[:400]
    return [
        Finding(
            code="wrong_value",
            message=f"{reply.label}: the message {payload!r} on {topic!r} should be there once"
            f"{' and nothing else' if filtered else ''}, the reply says {shown}",
            requirement="MQT-004",
            evidence=json.dumps(reply.envelope, ensure_ascii=False, default=repr)[:400],
        )
    ]


def tells(reply: Reply, payload: str) -> bool:
    """Tell whether a message with this payload is in the answer."""
    return any(message.content == payload.encode() for message in listed(reply.outputs))
