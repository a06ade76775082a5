"""How messages are had from an adapter: most subscribe and are asked later; some only answer a call that waits."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from pytest_otmcp.observation import Reply
from pytest_otmcp.repetition import Repetition

__all__ = ["collect"]

COLLECT_S = 2
"""How long a call that waits for messages is told to wait."""

Messages = Mapping[str, tuple[str, str]]


async def collect(run: Repetition, messages: Messages) -> list[Reply]:
    """Ask for the messages on several topic filters at once, and publish one for each when all are subscribed to.

    Args:
        messages: topic filter to topic and payload.
    """

    async def publish() -> None:
        await run.mqtt.wait_for(kind="SUBACK", direction="out", count=len(messages), timeout_s=COLLECT_S)
        for topic, payload in messages.values():
            await run.mqtt.publish_from_kit(topic, payload.encode())

    calls = (run.mqtt.call("messages", filter=text, seconds=COLLECT_S) for text in messages)
    replies, _ = await asyncio.gather(run.together(*calls), publish())
    for reply, (topic, payload) in zip(replies, messages.values(), strict=True):
        run.receives(reply, topic, payload)
    return replies
