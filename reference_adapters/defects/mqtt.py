"""Defects of an MQTT adapter."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from ..core import AdapterError, AdapterServer, Call
from ..mqtt import connection, inbox
from ..mqtt import link as mqtt_link
from ..mqtt.connection import Message
from .any_protocol import answers_twice_from_one_exchange
from .mutant import Data, Handler, Mutant, also, each, wrap

__all__ = ["MUTANTS", "link_of"]

_PUBLISH = "publish_message"
_GONE = ("connect_failed", "connection_lost")
_QUESTIONS = 5


def link_of(server: AdapterServer) -> mqtt_link.Link:
    """Return the adapter's connection to the broker."""
    link: mqtt_link.Link = server._tools[_PUBLISH].handler.__self__._link
    return link


def publish_not_sent(genuine: Handler) -> Handler:
    async def handler(call: Call, arguments: Any) -> Data:
        if not arguments.topic:
            refused: Data = await genuine(call, arguments)
            return refused
        return {"topic": arguments.topic, "qos": 0, "retain": False, "payload_bytes": 1, "delivery": "unacknowledged"}

    return handler


def keeps_what_failed(kept: list[Message], topic: str | None = None) -> Callable[[Handler], Handler]:
    """Return the change that what could not be published is kept, to be published on this topic or on its own one."""

    def keeping(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            try:
                data: Data = await genuine(call, arguments)
            except AdapterError as error:
                if error.code in _GONE:
                    kept.append(Message(topic=topic or arguments.topic, payload=arguments.payload.encode()))
                raise
            return data

        return handler

    return keeping


def made_up_for(server: AdapterServer, topic: str | None = None, after_s: float = 0.0) -> None:
    """Keep what could not be published, and publish it with the next connection, or so many seconds later, on this topic or on its own."""
    kept: list[Message] = []
    genuine_restore = mqtt_link.Link._restore

    def send(made: Any) -> None:
        while kept:
            made.send(kept.pop(0))

    async def restore(link: mqtt_link.Link, made: Any) -> None:
        await genuine_restore(link, made)
        if after_s:
            asyncio.get_running_loop().call_later(after_s, send, made)
        else:
            send(made)

    mqtt_link.Link._restore = restore
    each(_PUBLISH, change=keeps_what_failed(kept, topic))(server)


def delivered_later(server: AdapterServer) -> None:
    """Keep what could not be published, and publish it on another topic when the broker has answered some questions."""
    link, kept = link_of(server), list[Message]()
    answered = 0

    def delivering(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            nonlocal answered
            data: Data = await genuine(call, arguments)
            answered += bool(kept)
            if answered >= _QUESTIONS:
                for message in kept:
                    link._connection.send(message)
                kept.clear()
            return data

        return handler

    each(_PUBLISH, change=keeps_what_failed(kept, "line/late"))(server)
    each("get_broker_info", change=delivering)(server)


def forgets_subscriptions(server: AdapterServer) -> None:
    genuine = mqtt_link.Link._restore

    async def restore(link: mqtt_link.Link, made: Any) -> None:
        kept, link.subscriptions = link.subscriptions, {}
        try:
            await genuine(link, made)
        finally:
            link.subscriptions = kept

    mqtt_link.Link._restore = restore


def equal_topics_only(server: AdapterServer) -> None:
    inbox.matches = lambda text, topic: text == topic


async def heartbeat(server: AdapterServer, call: Call) -> None:
    publish = server._tools[_PUBLISH]
    # At QoS 1, so that the broker has it before the reply is sent, and not during the next call.
    await publish.handler(call, publish.model(topic="control/heartbeat", payload="1", qos=1))


def retained(genuine: Handler) -> Handler:
    async def handler(call: Call, arguments: Any) -> Data:
        asked = arguments if "retain" in arguments.model_fields_set else arguments.model_copy(update={"retain": True})
        data: Data = await genuine(call, asked)
        return data

    return handler


def status_from_memory(server: AdapterServer) -> None:
    # The answer to a PINGREQ at the right moment would be an exchange with the broker.
    connection.KEEPALIVE_S = 60
    answers_twice_from_one_exchange("get_broker_info")(server)


def subscribed_topics_only(server: AdapterServer) -> None:
    mqtt_link.matches = lambda text, topic: text == topic


def clamped_qos(server: AdapterServer) -> None:
    tool = server._tools["subscribe_topic"]
    anything = type("Anything", (tool.model,), {"__annotations__": {"qos": int}, "__module__": __name__})

    def clamping(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data: Data = await genuine(call, tool.model(topic=arguments.topic, qos=min(arguments.qos, 2)))
            return data

        return handler

    wrap(server, "subscribe_topic", clamping, model=anything)


MUTANTS = (
    Mutant(
        id="MU-14q",
        protocol="mqtt",
        sentence="A publish succeeds, and nothing is sent.",
        bend=each(_PUBLISH, change=publish_not_sent),
        items="Q3 X2 X2p FQ1 FX1 S5 S11",
        requirements="ADR-006 MQT-001",
        waits=True,
    ),
    Mutant(
        id="MU-29",
        protocol="mqtt",
        sentence="A publish that failed is made up for when the broker is back.",
        bend=made_up_for,
        items="S11",
        requirements="WR-010",
        recovers=True,
    ),
    Mutant(
        id="MU-29d",
        protocol="mqtt",
        sentence="What could not be published is published on another topic, during the next item.",
        bend=delivered_later,
        items="R-mqtt",
        requirements="WR-010",
        recovers=True,
    ),
    Mutant(
        id="MU-36q",
        protocol="mqtt",
        sentence="A status soon after another is told from memory, as if from the broker.",
        bend=status_from_memory,
        items="Q1 Q2 X1 X1p S8 S11",
        requirements="ENV-008 RD-004",
    ),
    Mutant(
        id="MU-53q",
        protocol="mqtt",
        sentence="The tool that tells the broker's status publishes a heartbeat below control/.",
        bend=also("get_broker_info", action=heartbeat),
        items="Q1 Q2 Q3 Q4 X1 X1p S2 S5 S8 S11",
        requirements="MCP-008 WR-003 WR-004 WR-010",
    ),
    Mutant(
        id="MU-65",
        protocol="mqtt",
        sentence="Subscriptions that died with the connection are listed as active.",
        bend=forgets_subscriptions,
        items="S11",
        requirements="REC-004",
    ),
    Mutant(
        id="MU-66",
        protocol="mqtt",
        sentence="Messages are retained unless the call says otherwise.",
        bend=each(_PUBLISH, change=retained),
        items="Q3 X2 X2p FQ1 FX1 S5",
        requirements="MQT-003",
    ),
    Mutant(
        id="MU-67a",
        protocol="mqtt",
        sentence="Messages are looked up by their topic; a wildcard finds none.",
        bend=equal_topics_only,
        items="Q2",
        requirements="MQT-004",
    ),
    Mutant(
        id="MU-67b",
        protocol="mqtt",
        sentence="A message is kept only if its topic is a subscription's text, so wildcards select nothing.",
        bend=subscribed_topics_only,
        items="Q2 S2",
        requirements="MQT-004",
    ),
    Mutant(
        id="MU-69",
        protocol="mqtt",
        sentence="QoS 5 is taken for QoS 2.",
        bend=clamped_qos,
        items="FQ2",
        requirements="ADR-007",
    ),
)
