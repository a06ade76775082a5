"""Defects of an MQTT adapter."""

from __future__ import annotations

import asyncio
from typing import Any

from ..core import AdapterError, AdapterServer, Call
from ..mqtt import connection, inbox
from ..mqtt import link as mqtt_link
from ..mqtt.connection import Message
from .any_protocol import answers_twice_from_one_exchange
from .defect import Change, Data, Handler, also, around, defect, tools_of

__all__ = ["DEFECTS", "link_of"]

_PUBLISH = "publish_message"
_GONE = ("connect_failed", "connection_lost")
_QUESTIONS = 5


def link_of(server: AdapterServer) -> mqtt_link.Link:
    """Return the adapter's connection to the broker."""
    link: mqtt_link.Link = tools_of(server, _PUBLISH)._link
    return link


async def publish_not_sent(genuine: Handler, call: Call, arguments: Any) -> Data:
    if not arguments.topic:
        refused: Data = await genuine(call, arguments)
        return refused
    return {"topic": arguments.topic, "qos": 0, "retain": False, "payload_bytes": 1, "delivery": "unacknowledged"}


def keeps_what_failed(kept: list[Message], topic: str | None = None) -> Change:
    """Return the change that what could not be published is kept, to be published on this topic or on its own one."""

    @around(_PUBLISH)
    async def keeping(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            return await genuine(call, arguments)
        except AdapterError as error:
            if error.code in _GONE:
                kept.append(Message(topic=topic or arguments.topic, payload=arguments.payload.encode()))
            raise

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
    keeps_what_failed(kept, topic)(server)


def delivered_later(server: AdapterServer) -> None:
    """Keep what could not be published, and publish it on another topic when the broker has answered some questions."""
    link, kept = link_of(server), list[Message]()
    answered = 0

    @around("get_broker_info")
    async def delivering(genuine: Handler, call: Call, arguments: Any) -> Data:
        nonlocal answered
        data = await genuine(call, arguments)
        answered += bool(kept)
        if answered >= _QUESTIONS:
            for message in kept:
                link._connection.send(message)
            kept.clear()
        return data

    keeps_what_failed(kept, "line/late")(server)
    delivering(server)


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


async def retained(genuine: Handler, call: Call, arguments: Any) -> Data:
    asked = arguments if "retain" in arguments.model_fields_set else arguments.model_copy(update={"retain": True})
    data = await genuine(call, asked)
    return data


def status_from_memory(server: AdapterServer) -> None:
    # The answer to a PINGREQ at the right moment would be an exchange with the broker.
    connection.KEEPALIVE_S = 60
    answers_twice_from_one_exchange("get_broker_info")(server)


def subscribed_topics_only(server: AdapterServer) -> None:
    mqtt_link.matches = lambda text, topic: text == topic


def clamped_qos(server: AdapterServer) -> None:
    tool = server._tools["subscribe_topic"]
    anything = type("Anything", (tool.model,), {"__annotations__": {"qos": int}, "__module__": __name__})

    @around("subscribe_topic", model=anything)
    async def clamping(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, tool.model(topic=arguments.topic, qos=min(arguments.qos, 2)))
        return data

    clamping(server)


DEFECTS = (
    defect(
        "MU-14q",
        "mqtt",
        "A publish succeeds, and nothing is sent.",
        around(_PUBLISH)(publish_not_sent),
        "Q3 X2 X2p FQ1 FX1 S5 S11",
        "ADR-006 MQT-001",
        waits=True,
    ),
    defect(
        "MU-29",
        "mqtt",
        "A publish that failed is made up for when the broker is back.",
        made_up_for,
        "S11",
        "WR-010",
        recovers=True,
    ),
    defect(
        "MU-29d",
        "mqtt",
        "What could not be published is published on another topic, during the next item.",
        delivered_later,
        "R-mqtt",
        "WR-010",
        recovers=True,
    ),
    defect(
        "MU-36q",
        "mqtt",
        "A status soon after another is told from memory, as if from the broker.",
        status_from_memory,
        "Q1 Q2 X1 X1p S8 S11",
        "ENV-008 RD-004",
    ),
    defect(
        "MU-53q",
        "mqtt",
        "The tool that tells the broker's status publishes a heartbeat below control/.",
        also("get_broker_info", action=heartbeat),
        "Q1 Q2 Q3 Q4 X1 X1p S2 S5 S8 S11",
        "MCP-008 WR-003 WR-004 WR-010",
    ),
    defect(
        "MU-65",
        "mqtt",
        "Subscriptions that died with the connection are listed as active.",
        forgets_subscriptions,
        "S11",
        "REC-004",
    ),
    defect(
        "MU-66",
        "mqtt",
        "Messages are retained unless the call says otherwise.",
        around(_PUBLISH)(retained),
        "Q3 X2 X2p FQ1 FX1 S5",
        "MQT-003",
    ),
    defect(
        "MU-67a",
        "mqtt",
        "Messages are looked up by their topic; a wildcard finds none.",
        equal_topics_only,
        "Q2",
        "MQT-004",
    ),
    defect(
        "MU-67b",
        "mqtt",
        "A message is kept only if its topic is a subscription's text, so wildcards select nothing.",
        subscribed_topics_only,
        "Q2 S2",
        "MQT-004",
    ),
    defect("MU-69", "mqtt", "QoS 5 is taken for QoS 2.", clamped_qos, "FQ2", "ADR-007"),
)
