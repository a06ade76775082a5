"""The trial of how an adapter goes on after an outage: by itself, by its connect step, or in a new session only."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from ..core.errors import SubjectError
from ..protocols.registry import protocols
from ..subject.grammar import LONGEST_RECOVERY_S
from .evidence import claims_success, failure_rules
from .experimenter import Experimenter
from .proposal import Proposal

__all__ = ["look_after_outage"]

_WINDOW_S, _PAUSE_S = 2 * LONGEST_RECOVERY_S, 0.1
"""Time for which an adapter may go on to fail: twice as long as it may at most; and between two calls."""


async def look_after_outage(experimenter: Experimenter, proposals: Mapping[str, Proposal]) -> str | None:
    """Call what is proven and reads, while the device is away and when it is back.

    Returns:
        The value of ``recovery`` in the subject file; None where nothing shows it, or nothing helped.
    """
    known = protocols()[experimenter.adapter.adapter.protocol]
    calls = [
        call for call in known.proof.unreachable if call.operation in proposals and proposals[call.operation].proven
    ]
    call = min(calls, key=lambda one: known.operations[one.operation].status, default=None)
    if call is None:
        return None
    proposal, adapter = proposals[call.operation], experimenter.adapter

    async def works(window_s: float) -> bool:
        until = asyncio.get_running_loop().time() + window_s
        while True:
            message, _ = await experimenter.answer(
                proposal.guess, proposal.offset, call.made(experimenter.random), writes=False
            )
            if message is not None and _succeeded(message, proposal) and await _was_reached(experimenter):
                return True
            if message is None or asyncio.get_running_loop().time() > until:
                return False
            await asyncio.sleep(_PAUSE_S)

    try:
        await experimenter.renew()
        if not await works(0.0):
            return None
        await experimenter.device.stop()
        try:
            await experimenter.answer(proposal.guess, proposal.offset, call.made(experimenter.random), writes=False)
        finally:
            await experimenter.device.start()
        if await works(_WINDOW_S):
            return "same_session"
        if adapter.adapter.connect is not None and await adapter.connect() is None and await works(0.0):
            return "connect_step"
        await adapter.close()
        await adapter.open()
        return "new_session" if await works(_WINDOW_S) else None
    except SubjectError:
        return None


def _succeeded(message: Mapping[str, object], proposal: Proposal) -> bool:
    good = [] if proposal.good is None else [proposal.good]
    return claims_success(message) and not failure_rules(message, good, proposal.form or "text")


async def _was_reached(experimenter: Experimenter) -> bool:
    """Tell whether a request has come since the device was started again, with a journal of its own."""
    entries = (await experimenter.device.journal(0)).entries
    return any(entry["request"] and entry["origin"] == "client" for entry in entries)
