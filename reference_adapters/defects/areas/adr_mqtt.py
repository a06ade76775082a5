"""Defects that the checks of the area ADR on MQTT notice."""

from __future__ import annotations

import re
from typing import Any

from ...core import AdapterError, AdapterServer, Call
from ...mqtt import tools as mqtt_tools
from ..mutant import Bend, Data, Handler, Mutant, wrap

__all__ = ["MUTANTS"]


def null_characters_taken(server: AdapterServer) -> None:
    genuine = mqtt_tools.check_name

    def check_name(topic: str) -> str:
        genuine(topic.replace("\0", "") if len(topic) > 1 else topic)
        return topic

    mqtt_tools.check_name = check_name


def topics_cut_off(server: AdapterServer) -> None:
    """Publish on the first bytes of a topic that is longer than a packet can say."""
    genuine = mqtt_tools.check_name

    def check_name(topic: str) -> str:
        return genuine(topic.encode()[:0xFFFF].decode("utf-8", "ignore"))

    mqtt_tools.check_name = check_name


def filters_put_right(server: AdapterServer) -> None:
    genuine = mqtt_tools.check_filter

    def check_filter(text: str) -> str:
        try:
            return genuine(text)
        except AdapterError:
            return genuine(re.sub("[+#\0]", "", text))

    mqtt_tools.check_filter = check_filter


def clamped(name: str) -> Bend:
    """Return the defect that this tool takes a quality of service that does not exist for the nearest one."""

    def clamping(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data: Data = await genuine(call, arguments.model_copy(update={"qos": max(0, min(arguments.qos, 2))}))
            return data

        return handler

    def bend(server: AdapterServer) -> None:
        tool = server._tools[name]
        anything = type("Anything", (tool.model,), {"__annotations__": {"qos": int}, "__module__": __name__})
        wrap(server, name, clamping, model=anything)

    return bend


MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        id="MU-68c",
        protocol="mqtt",
        sentence="A topic that is too long is cut off, and the message is published on what remains.",
        bend=topics_cut_off,
        items="ADR-006.mqtt",
        requirements="ADR-006",
        areas="adr",
    ),
    Mutant(
        id="MU-68t",
        protocol="mqtt",
        sentence="A topic to publish on may have null characters.",
        bend=null_characters_taken,
        items="ADR-006.mqtt",
        requirements="ADR-006",
        areas="adr",
    ),
    Mutant(
        id="MU-69c",
        protocol="mqtt",
        sentence="A subscription with QoS 5 is one with QoS 2.",
        bend=clamped("subscribe_topic"),
        items="ADR-002.mqtt ADR-007.mqtt",
        requirements="ADR-002 ADR-007",
        areas="adr",
        quick=True,
    ),
    Mutant(
        id="MU-69p",
        protocol="mqtt",
        sentence="A publication with QoS 5 is one with QoS 2.",
        bend=clamped("publish_message"),
        items="ADR-002.mqtt ADR-007.mqtt",
        requirements="ADR-002 ADR-007",
        areas="adr",
    ),
    Mutant(
        id="MU-69f",
        protocol="mqtt",
        sentence="A topic filter that is wrong is put right in silence.",
        bend=filters_put_right,
        items="ADR-007.mqtt",
        requirements="ADR-007",
        areas="adr",
    ),
)
