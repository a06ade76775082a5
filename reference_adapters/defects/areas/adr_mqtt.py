"""Defects that the checks of the area ADR on MQTT notice."""

from __future__ import annotations

import re
from typing import Any

from ...core import AdapterError, AdapterServer, Call
from ...mqtt import tools as mqtt_tools
from ..defect import Change, Data, Defect, Handler, around, defect

__all__ = ["DEFECTS"]


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


def clamped(name: str) -> Change:
    """Return the defect that this tool takes a quality of service that does not exist for the nearest one."""

    def apply(server: AdapterServer) -> None:
        tool = server._tools[name]
        anything = type("Anything", (tool.model,), {"__annotations__": {"qos": int}, "__module__": __name__})

        @around(name, model=anything)
        async def clamping(genuine: Handler, call: Call, arguments: Any) -> Data:
            return await genuine(call, arguments.model_copy(update={"qos": max(0, min(arguments.qos, 2))}))

        clamping(server)

    return apply


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-68c",
        "mqtt",
        "A topic that is too long is cut off, and the message is published on what remains.",
        topics_cut_off,
        "ADR-006",
    ),
    defect("MU-68t", "mqtt", "A topic to publish on may have null characters.", null_characters_taken, "ADR-006"),
    defect(
        "MU-69c",
        "mqtt",
        "A subscription with QoS 5 is one with QoS 2.",
        clamped("subscribe_topic"),
        "ADR-002 ADR-007",
        quick=True,
    ),
    defect(
        "MU-69p", "mqtt", "A publication with QoS 5 is one with QoS 2.", clamped("publish_message"), "ADR-002 ADR-007"
    ),
    defect("MU-69f", "mqtt", "A topic filter that is wrong is put right in silence.", filters_put_right, "ADR-007"),
)
