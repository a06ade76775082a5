"""Defects that the checks of the area MQT notice."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from ...core import AdapterError, AdapterServer, Call, Lost
from ...mqtt.connection import Connection, Delivery, Message
from ...mqtt.inbox import Inbox
from ...mqtt.link import Link
from ..defect import Data, Defect, Handler, around, defect, told
from ..mqtt import equal_topics_only, retained, subscribed_topics_only

__all__ = ["DEFECTS"]

_PUBLISH = "publish_message"
_PATIENCE_S = 1.0


def the_same_is_spared(server: AdapterServer) -> None:
    """The defect that a message which equals the one before is told as published, and not sent."""
    last: list[tuple[object, Data]] = []

    @around(_PUBLISH)
    async def instead(genuine: Handler, call: Call, arguments: Any) -> Data:
        if last and last[0][0] == arguments:
            return last[0][1]
        data = await genuine(call, arguments)
        last[:] = [(arguments, data)]
        return data

    instead(server)


async def _delivered_at_once(connection: Connection, deliveries: Sequence[Delivery]) -> None:
    return None


def acknowledgements_not_awaited(server: AdapterServer) -> None:
    Connection.delivered = _delivered_at_once


def acknowledgements_awaited_in_vain(server: AdapterServer) -> None:
    genuine = Connection.delivered

    async def delivered(connection: Connection, deliveries: Sequence[Delivery]) -> None:
        try:
            async with asyncio.timeout(_PATIENCE_S):
                await genuine(connection, deliveries)
        except (AdapterError, Lost, TimeoutError):
            pass

    Connection.delivered = delivered


def refusals_not_read(server: AdapterServer) -> None:
    Delivery.refuse = lambda delivery, reason: None


def granting(change: Callable[[int | None], int | None]) -> Callable[[AdapterServer], None]:
    """Return the defect that the broker's answers to SUBSCRIBE are taken for others."""

    def apply(server: AdapterServer) -> None:
        genuine = Connection.subscribe

        async def subscribe(connection: Connection, filters: Mapping[str, int]) -> list[int | None]:
            return [change(granted) for granted in await genuine(connection, filters)]

        Connection.subscribe = subscribe

    return apply


def subscriptions_not_awaited(server: AdapterServer) -> None:
    genuine = Connection.subscribe

    async def subscribe(connection: Connection, filters: Mapping[str, int]) -> list[int]:
        try:
            async with asyncio.timeout(_PATIENCE_S):
                return await genuine(connection, filters)
        except (AdapterError, Lost, TimeoutError):
            return list(filters.values())

    Connection.subscribe = subscribe


def unsubscribing_forgets_alone(server: AdapterServer) -> None:
    async def unsubscribe(link: Link, call: Any, text: str) -> None:
        await link.ask(call)
        link.subscriptions.pop(text, None)

    Link.unsubscribe = unsubscribe


def uncounted(server: AdapterServer) -> None:
    Inbox.take_dropped = lambda inbox: 0


def newest_first(data: dict[str, Any]) -> dict[str, Any]:
    return {**data, "messages": data["messages"][::-1]}


def text_alone(server: AdapterServer) -> None:
    genuine = Link._received

    def received(link: Link, message: Message) -> None:
        try:
            message.payload.decode()
        except UnicodeDecodeError:
            return
        genuine(link, message)

    Link._received = received


def retain_not_told(data: dict[str, Any]) -> dict[str, Any]:
    return {**data, "messages": [{**message, "retain": False} for message in data["messages"]]}


def stripped(server: AdapterServer) -> None:
    genuine = Connection.send

    def send(connection: Connection, message: Message) -> Delivery:
        payload = message.payload.strip() if message.topic.startswith("control/") else message.payload
        return genuine(
            connection, Message(topic=message.topic, payload=payload[:16_384], qos=message.qos, retain=message.retain)
        )

    Connection.send = send


def receiving(change: Callable[[list[Message], Message], Message | None]) -> Callable[[AdapterServer], None]:
    """Return the defect that a message is kept as another one, or not at all, by what came before it."""

    def apply(server: AdapterServer) -> None:
        genuine = Link._received
        last: list[Message] = []

        def received(link: Link, message: Message) -> None:
            kept = change(last, message)
            last[:] = [message]
            if kept is not None:
                genuine(link, kept)

        Link._received = received

    return apply


def _no_repetition(last: list[Message], message: Message) -> Message | None:
    return None if last and last[0].payload == message.payload else message


def _no_repetition_on_a_topic(last: list[Message], message: Message) -> Message | None:
    return None if last and (last[0].topic, last[0].payload) == (message.topic, message.payload) else message


def _lower_case(last: list[Message], message: Message) -> Message:
    return replace(message, topic=message.topic.lower())


def topics_in_lower_case(server: AdapterServer) -> None:
    genuine = Connection.send

    def send(connection: Connection, message: Message) -> Delivery:
        return genuine(connection, replace(message, topic=message.topic.lower()))

    Connection.send = send


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-14sq",
        "mqtt",
        "A message that equals the one before is told as published, and not sent.",
        the_same_is_spared,
        "MQT-001",
    ),
    defect(
        "MU-67e",
        "mqtt",
        "Of messages with equal payloads in a row the first is kept.",
        receiving(_no_repetition),
        "MQT-004",
    ),
    defect(
        "MU-67f",
        "mqtt",
        "Of equal messages in a row on one topic the first is kept.",
        receiving(_no_repetition_on_a_topic),
        "MQT-004",
    ),
    defect("MU-67l", "mqtt", "Topics of messages are kept in lower case.", receiving(_lower_case), "MQT-004"),
    defect(
        "MU-68l",
        "mqtt",
        "Messages are published to the topic in lower case.",
        topics_in_lower_case,
        "MQT-003",
        "ENV-007 MQT-001",
    ),
    defect("MU-63", "mqtt", "A publish succeeds before its PUBACK.", acknowledgements_not_awaited, "MQT-001"),
    defect(
        "MU-63r",
        "mqtt",
        "A message that the broker refuses is told as acknowledged.",
        refusals_not_read,
        "ERR-004 MQT-001",
    ),
    defect(
        "MU-63w",
        "mqtt",
        "A PUBACK is waited for, and the publish succeeds without it.",
        acknowledgements_awaited_in_vain,
        "MQT-001",
    ),
    defect(
        "MU-64",
        "mqtt",
        "A subscription that the broker refuses is a success.",
        granting(lambda granted: granted if granted is not None and granted < 0x80 else 0),
        "MQT-002",
        "ENV-007 MQT-002",
    ),
    defect(
        "MU-64g",
        "mqtt",
        "The QoS that was asked for is told as the one that was granted.",
        told("subscribe_topic", change=lambda data: {**data, "granted_qos": data["qos"]}),
        "MQT-002",
    ),
    defect(
        "MU-64s",
        "mqtt",
        "A SUBACK is waited for, and the subscription succeeds without it.",
        subscriptions_not_awaited,
        "MQT-002",
    ),
    defect(
        "MU-64u",
        "mqtt",
        "A subscription that is ended is only forgotten.",
        unsubscribing_forgets_alone,
        "MQT-002",
        "ENV-007 MQT-002",
    ),
    defect(
        "MU-66m",
        "mqtt",
        "Messages are retained unless the call says otherwise.",
        around(_PUBLISH)(retained),
        "MQT-001 MQT-003",
        "MQT-003",
    ),
    defect(
        "MU-66f",
        "mqtt",
        "That a message was retained is not told.",
        told("read_messages", change=retain_not_told),
        "MQT-003",
    ),
    defect(
        "MU-66p",
        "mqtt",
        "Blanks at the ends of a payload, and what is above 16 KiB, are cut off.",
        stripped,
        "MQT-003",
        "MQT-001",
    ),
    defect(
        "MU-67c", "mqtt", "Messages are looked up by their topic; a wildcard finds none.", equal_topics_only, "MQT-004"
    ),
    defect(
        "MU-67d",
        "mqtt",
        "A message is kept only if its topic is a subscription's text.",
        subscribed_topics_only,
        "MQT-004",
    ),
    defect("MU-67o", "mqtt", "The newest message comes first.", told("read_messages", change=newest_first), "MQT-004"),
    defect("MU-89d", "mqtt", "Messages that are dropped are not counted.", uncounted, "MQT-004"),
    defect("MU-123w", "mqtt", "Messages that are no text are thrown away.", text_alone, "MQT-004"),
)
