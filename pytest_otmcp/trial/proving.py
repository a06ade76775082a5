"""Proves that an adapter's session talks to the mock device, before anything is written through it.

What is asked comes from the protocol (``protocols.proof``); here is in which order, how long, and what is said when nothing came
back. The same steps are taken on a bench and on the stored history of a run.
"""

from __future__ import annotations

import json
import random
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from ..core.errors import NoBindingError
from ..protocols.journal import JournalEntry
from ..protocols.proof import ENOUGH_BITS, Proof, Question, Way
from .reply import Reply
from .subject_in_rig import SubjectInRig

__all__ = ["ARRIVAL", "Provable", "prove", "why_reachable"]

ARRIVAL = "arrival"
"""What proved the session of an adapter that has no operation but such as write."""

_WINDOW_S = 1.0
"""How long a value may take to come back: an adapter may answer from a poll of its own, or from a short memory."""

_PAUSE_S = 0.05

_NOTICING_S = 1.0
"""How long an adapter may take to notice that its device is away (requirement REC-002: one keep-alive)."""

_FAILURES_IN_A_ROW = 2
"""Calls that must fail during an outage before something is written: an adapter may try another device after the first one."""

_ADDRESS = re.compile(
    r"(?!https?:)\b[a-z][a-z0-9+.-]{0,30}://(?:[\w.\[\]:-]+|/[\w./-]+)|\b(?:\d{1,3}\.){3}\d{1,3}:\d{1,5}\b|\blocalhost:\d{1,5}\b"
)


class _Device(Protocol):
    @property
    def url(self) -> str:
        """Where it listens."""

    async def poke(self, **params: object) -> None:
        """Set a value out of band."""


class Provable(Protocol):
    """An adapter at its device, as far as a proof needs them."""

    protocol: str
    subject: SubjectInRig

    @property
    def device(self) -> _Device:
        """The mock device."""

    @property
    def proof(self) -> Proof:
        """The ways to prove it."""

    def can_ask_first(self, operation: str, inputs: Mapping[str, object]) -> bool:
        """The subject claims the operation and says how to ask for it with these inputs, before any other operation."""

    async def ask(self, operation: str, inputs: Mapping[str, object]) -> Reply:
        """Perform an operation that writes nothing; nothing is expected of its reply."""

    async def journal(self) -> list[JournalEntry]:
        """Return what has reached the device; every answer goes on where the one before ended."""

    async def arrived(self) -> bool:
        """The device has seen a client arrive since the session began."""

    async def pause(self, seconds: float) -> None:
        """Let time pass."""
        ...


_AFTER_AN_OUTAGE = "It was proven to talk to it before: it has lost its device, and has not found it again."


@dataclass(frozen=True, slots=True, kw_only=True)
class _Attempt:
    """What came of one way: the last reply, whether the mock saw a request meanwhile, how many random bits came through."""

    reply: Reply
    reached: bool
    bits: int


async def prove(
    at: Provable, rng: random.Random, *, preferred: str | None, time_scale: float
) -> tuple[str | None, str]:
    """Try the ways of the protocol until one proves the session.

    Args:
        rng: source of what nobody can guess.
        preferred: the operation that proved an earlier session of the adapter; it is tried first.

    Returns:
        The operation that proved it, or None and the sentence that says why nothing may be written.

    Raises:
        NoBindingError: the subject file has no way to prove it.
    """
    proof = at.proof
    failed: list[_Attempt] = []
    strong, bits, unlisted = False, 0, set[str]()
    for way in sorted(proof.ways, key=lambda way: way.operation != preferred):
        if (way.weak and strong) or way.waiting not in (None, at.subject.blocks(way.operation)):
            continue
        question = way.ask(rng)
        if not at.can_ask_first(way.operation, question.inputs):
            continue
        # Whoever was proven before may have lost the device since, and may connect again in its own time.
        window_s = _WINDOW_S if preferred is None else max(_WINDOW_S, at.subject.recovery_s)
        attempt = await _try(at, way, question, rng, bits, int(window_s * max(1.0, time_scale) * 1e9))
        if attempt is None:
            unlisted.add(way.operation)
            continue
        bits = attempt.bits
        if bits >= ENOUGH_BITS:
            return way.operation, ""
        failed.append(attempt)
        strong = strong or not way.weak
    # A weak way shows no more than an arrival does: a status that is told from memory is as good as none.
    remembered = not strong and all(attempt.reply.success for attempt in failed)
    if remembered and proof.arrival is not None and await at.arrived():
        return ARRIVAL, ""
    if not failed and not unlisted:
        raise NoBindingError(_unprovable(at, arrived=preferred == ARRIVAL))
    return None, _explained(at, failed, known=preferred is not None)


async def _try(
    at: Provable, way: Way, question: Question, rng: random.Random, total: int, window_ns: int
) -> _Attempt | None:
    """Ask in one way, this question first, until enough random bits came through, with those of other ways; None when the session does not list its tool."""
    begun_ns, reached = 0, False
    while True:
        before = len(await at.journal())
        while True:
            for poke in question.pokes:
                await at.device.poke(**poke)
            reply = await at.ask(way.operation, question.inputs)
            if not reply.listed:
                return None
            entries = (await at.journal())[before:]
            reached = reached or any(entry["request"] and entry["origin"] == "client" for entry in entries)
            bits = question.bits(reply.outputs, entries)
            begun_ns = begun_ns or reply.exchange.sent_ns
            if bits or not reply.answered or reply.exchange.sent_ns - begun_ns >= window_ns:
                break
            await at.pause(_PAUSE_S)
        total += bits
        if total >= ENOUGH_BITS or not bits:
            return _Attempt(reply=reply, reached=reached, bits=total)
        question = way.ask(rng)


async def why_reachable(at: Provable, *, time_scale: float) -> str | None:
    """Make sure that the adapter reaches nothing while the mock is away: one that goes over to another device would write there.

    Returns:
        None when nothing is reached; else why nothing may be written, a sentence.
    """
    rng = random.Random(at.protocol)
    calls = at.proof.unreachable
    asked = next((call for call in calls if at.can_ask_first(call.operation, call.made(rng))), None)
    if asked is None:
        return "no operation shows whether the adapter reaches another device during an outage; nothing was written"
    failures, begun_ns = 0, 0
    while failures < _FAILURES_IN_A_ROW:
        reply = await at.ask(asked.operation, asked.made(rng))
        begun_ns = begun_ns or reply.exchange.sent_ns
        failures = failures + 1 if _is_cut_off(reply) else 0
        if not failures:
            if reply.exchange.sent_ns - begun_ns >= _NOTICING_S * time_scale * 1e9:
                came = ": the answer comes from memory or from another device"
                if _brings_nothing(reply):
                    came = " and brings nothing, as if the device had nothing to say"
                elif not reply.outputs:
                    came = ": another device was asked, or none"
                return f"the mock device at {at.device.url} is stopped, and {reply.label} still succeeds{came}; nothing was written"
            await at.pause(_PAUSE_S)
    return None


def _is_cut_off(reply: Reply) -> bool:
    # Some adapters answer with success, and then say ``false`` where they say whether there is a connection.
    return not reply.success or any(value is False for value in reply.outputs.values())


def _brings_nothing(reply: Reply) -> bool:
    return bool(reply.outputs) and all(value in ([], {}, "") for value in reply.outputs.values())


def _explained(at: Provable, failed: Sequence[_Attempt], *, known: bool) -> str:
    told = next((attempt for attempt in failed if attempt.reply.success and not attempt.reached), None)
    where = f"the mock device at {at.device.url}"
    if told is not None:
        # An adapter that answers, while the mock sees nothing, has its answers from somewhere else, if they say anything.
        named = _named(at, failed)
        whence = f"The answer is from another device or from memory{named}"
        if _brings_nothing(told.reply) and not named:
            whence = "The answer brings nothing, from wherever"
        elif not (told.reply.outputs or named):
            whence = "Another device was asked, or none"
        problem = (
            f"the adapter does not talk to {where}: {told.reply.label} succeeded, but the mock saw nothing of it, and the random "
            f"value that was set there did not come back. {whence}"
        )
    elif any(attempt.reached for attempt in failed):
        reply = next(attempt for attempt in failed if attempt.reached).reply
        problem = f"nothing shows that the adapter talks to {where} alone: the mock saw requests during {reply.label}, "
        problem += (
            "but the answer did not bring back the random value that was set there"
            if reply.success
            else f"which {_outcome(reply)}"
        )
        return f"{problem}; nothing was written"
    elif failed:
        problem = (
            f"nothing shows that the adapter talks to {where}: the mock saw nothing of {failed[0].reply.label}, "
            f"which {_outcome(failed[0].reply)}{_named(at, failed)}"
        )
    else:
        return f"nothing shows that the adapter talks to {where}: the session lists none of the tools that read; nothing was written"
    # Whoever has reached the mock before has the right address.
    return f"{problem}; nothing was written. {_AFTER_AN_OUTAGE if known else _advice(at)}"


def _unprovable(at: Provable, *, arrived: bool) -> str:
    proof = at.proof
    ways = " or ".join(dict.fromkeys(way.operation for way in proof.ways))
    arrival = ""
    if proof.arrival is not None:
        arrival = "; a connection that the adapter makes when it starts is enough, and "
        arrival += "that counted until a write that it reported did not reach the mock" if arrived else "it made none"
    return (
        f"{at.protocol}: nothing is written before a read has shown that the adapter talks to the mock device at {at.device.url}, and the "
        f"subject file binds none that can be asked for what shows it: bind {ways}{arrival}"
    )


def _outcome(reply: Reply) -> str:
    if not reply.answered:
        return "was not answered"
    if reply.success:
        return "succeeded"
    error = (reply.envelope or {}).get("error")
    text = error.get("message") if isinstance(error, dict) else None
    return f"failed ({str(text or 'without a word')[:160]})"


def _named(at: Provable, failed: Sequence[_Attempt]) -> str:
    """Say which device an answer names, if it names another one than the mock."""
    mock = at.device.url.rpartition("://")[2].rstrip("/")
    for attempt in failed:
        for found in _ADDRESS.findall(json.dumps(attempt.reply.envelope, ensure_ascii=False, default=str)):
            if found.rpartition("://")[2] != mock:
                return f", it names {found}"
    return ""


def _advice(at: Provable) -> str:
    keys = ", ".join(at.subject.addressed_by)
    if not keys:
        return f"Nothing below [adapter.{at.protocol}] of the subject file holds {{host}}, {{port}} or {{url}}."
    return f"Look at {keys} below [adapter.{at.protocol}] of the subject file: is that where the adapter takes its address from?"
