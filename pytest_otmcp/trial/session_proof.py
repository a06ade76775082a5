"""Proves a session that no repetition uses: that of a vendor's own test, or of ``otmcp doctor``."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Mapping
from typing import Any

from ..core.errors import NoBindingError
from ..protocols.journal import JournalEntry, judged
from ..protocols.proof import Proof
from ..protocols.registry import protocols
from .adapter_under_test import AdapterUnderTest
from .named_readings import with_readings
from .proving import prove, why_reachable
from .reply import Reply

__all__ = ["prove_session", "why_reachable_in_outage"]


class _Device:
    """The device of a session."""

    def __init__(self, under_test: AdapterUnderTest) -> None:
        self.url = under_test.endpoint.get("url", "")
        self.poke = under_test.device.poke


class _Session:
    """An adapter's session at its device, as :class:`~pytest_otmcp.trial.proving.Provable` wants it."""

    def __init__(self, under_test: AdapterUnderTest, since: int) -> None:
        self.protocol = under_test.adapter.protocol
        self.subject = under_test.stated
        self.device = _Device(under_test)
        self.proof = _proof(under_test)
        self._under_test = under_test
        self._since = since

    def can_ask_first(self, operation: str, inputs: Mapping[str, object]) -> bool:
        return self._under_test.is_bound(operation, inputs, first=True) and self.subject.claims(operation)

    async def ask(self, operation: str, inputs: Mapping[str, Any]) -> Reply:
        return await self._under_test.call(operation, inputs)

    async def journal(self) -> list[JournalEntry]:
        return judged((await self._under_test.device.journal(self._since)).entries)

    async def arrived(self) -> bool:
        session, arrival = self._under_test.cursor.session, protocols()[self.protocol].proof.arrival
        if session is None or arrival is None:
            return False
        return any(map(arrival, judged((await self._under_test.device.journal(session[1])).entries)))

    async def pause(self, seconds: float) -> None:
        await asyncio.sleep(seconds)


async def prove_session(under_test: AdapterUnderTest) -> str | None:
    """Prove that a session talks to its mock device, which runs, and leave the values there as they were.

    Returns:
        None when it is proven, now or before; else why it is not, a sentence.
    """
    cursor, device = under_test.cursor, under_test.device
    if cursor.proven is None and cursor.refused is None:
        image, since = await device.image(), await device.mark()
        rng = random.SystemRandom()
        try:
            operation, problem = await prove(
                _Session(under_test, since), rng, preferred=cursor.preferred, time_scale=1.0
            )
        except NoBindingError as gap:
            operation, problem = None, f"{gap}; nothing was written"
        finally:
            for poke in _proof(under_test).restore(image):
                await device.poke(**poke)
        if operation is None:
            cursor.refused = ("", problem)
        else:
            cursor.proven = cursor.preferred = operation
    return None if cursor.refused is None else cursor.refused[1]


def _proof(under_test: AdapterUnderTest) -> Proof:
    protocol = under_test.adapter.protocol
    return with_readings(protocols()[protocol].proof, protocol, under_test.adapter.vocabulary(readings=True))


async def why_reachable_in_outage(under_test: AdapterUnderTest) -> str | None:
    """Return why nothing may be written while the device is stopped: the adapter may still reach another one; or None."""
    return await why_reachable(_Session(under_test, 0), time_scale=1.0)
