"""The MQTT adapter with a vocabulary of its own: lights and a bell in the place of topics and payloads."""

from __future__ import annotations

import json
from typing import Annotated, Literal

from pydantic import Field
from typing_extensions import TypedDict

from ..core import AdapterServer, Arguments, Call, Nothing, tool
from .adapter import build as build_adapter
from .shapes import BrokerInfo, Publish
from .tools import Tools

__all__ = ["NamedTools", "build"]

_TRANSITION_S = 0.5
"""Every light takes so long; the messages say it, too."""

Room = Literal["kitchen", "hall"]


class Brightness(Arguments):
    """A light and how bright it is to be."""

    light: Room
    level: Annotated[int, Field(ge=0, le=254)]


class Switch(Arguments):
    """A light and what it is to be."""

    light: Room
    state: Literal["on", "off"]


class Scene(Arguments):
    """What all lights are to be."""

    state: Literal["on", "off"]


class Sent(TypedDict):
    """A command that the broker has."""

    delivery: str


class NamedTools:
    """The tools over those of the adapter."""

    def __init__(self, tools: Tools) -> None:
        self._tools = tools

    @tool("mqtt.info")
    async def bridge_status(self, call: Call, arguments: Nothing) -> BrokerInfo:
        """Tell whether the lights can be reached."""
        return await self._tools.get_broker_info(call, arguments)

    @tool("mqtt.publish", writes=True, idempotent=False)
    async def set_brightness(self, call: Call, arguments: Brightness) -> Sent:
        """Dim a light."""
        return await self._light(call, arguments.light, brightness=arguments.level)

    @tool("mqtt.publish", writes=True, idempotent=False)
    async def switch_light(self, call: Call, arguments: Switch) -> Sent:
        """Switch a light."""
        return await self._light(call, arguments.light, state=arguments.state.upper())

    @tool("mqtt.publish", writes=True, idempotent=False)
    async def ring_bell(self, call: Call, arguments: Nothing) -> Sent:
        """Ring the bell."""
        return await self._publish(call, "home/bell", "RING")

    @tool("mqtt.publish", writes=True, idempotent=False)
    async def switch_all(self, call: Call, arguments: Scene) -> Sent:
        """Switch the light in the kitchen, then that in the hall."""
        # Both before the first is sent: one of them alone is not what was asked for.
        call.changes(*((_topic(light), None) for light in ("kitchen", "hall")))
        await self._light(call, "kitchen", state=arguments.state.upper())
        return await self._light(call, "hall", state=arguments.state.upper())

    async def _light(self, call: Call, light: str, **members: object) -> Sent:
        return await self._publish(call, _topic(light), json.dumps({**members, "transition": _TRANSITION_S}))

    async def _publish(self, call: Call, topic: str, payload: str) -> Sent:
        published = await self._tools.publish_message(call, Publish(topic=topic, payload=payload, qos=1))
        return {"delivery": published["delivery"]}


def _topic(light: str) -> str:
    return f"home/{light}/set"


def build() -> AdapterServer:
    """Build the adapter that the environment configures.

    Raises:
        ConfigError: a setting cannot be used.
    """
    return build_adapter(NamedTools)
