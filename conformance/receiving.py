"""How messages are had from an adapter: most subscribe and are asked later; some only answer a call that waits."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping

from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply

__all__ = ["collect", "let_it_read"]

COLLECT_S = 2
"""How long a call that waits for messages is told to wait, on a machine that is not slow."""

SUBSCRIBING_S = 4.0
"""How long such a call is given to subscribe; what is published before nobody can receive."""

Messages = Mapping[str, tuple[str, str]]


async def collect(run: Repetition, messages: Messages) -> list[Reply]:
    """Ask for the messages on several topic filters at once, and publish one for each when all are subscribed to.

    Args:
        messages: topic filter to topic and payload.
    """
    # A slow machine is slow to subscribe as well, and that may count as waiting.
    seconds = math.ceil(COLLECT_S * max(1.0, run.time_scale))

    async def publish() -> None:
        wanted = len(messages)
        granted = await run.mqtt.wait_for(kind="SUBACK", direction="out", count=wanted, timeout_s=SUBSCRIBING_S)
        if len(granted) >= wanted:
            for topic, payload in messages.values():
                await run.mqtt.publish_from_kit(topic, payload.encode())

    calls = (run.mqtt.call("messages", filter=text, seconds=seconds) for text in messages)
    publishing = asyncio.create_task(publish())
    try:
        replies = await run.together(*calls)
    finally:
        # Also when there was no reply: nothing is to be published in the midst of the next repetition.
        await publishing
    for reply, (topic, payload) in zip(replies, messages.values(), strict=True):
        run.receives(reply, topic, payload)
    return replies


async def let_it_read(run: Repetition, filter: str) -> None:
    """An exchange on the adapter's connection: whatever the broker sent before it has been read by the adapter."""
    if run.mqtt.claims("info"):
        run.succeeds(await run.mqtt.call("info", role="control"))
    else:
        run.succeeds(await run.mqtt.call("subscribe", role="control", filter=filter, qos=0))
