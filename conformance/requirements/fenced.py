"""Writes within and beyond what an adapter was told that it may write; several areas ask for them."""

from __future__ import annotations

import math
import struct
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from ..commanded import asked_of_the_device
from .generated import properties
from .steps import NOTHING_SENT, citing, exercise, nothing_arrived, since, witness, written_once

__all__ = [
    "BEYOND",
    "FORBIDDEN",
    "Fenced",
    "another",
    "approved_numbers",
    "beyond",
    "can_be_asked",
    "fenced",
    "is_written",
    "refused",
    "whole",
    "written",
]

FORBIDDEN = ("access_denied", "not_writable", "illegal_address", "invalid_input")
"""Codes for a target that is not on the list; an adapter may know no other targets, or say so in its schema."""
BEYOND = ("range_overflow", "access_denied", "invalid_input", "illegal_value", "limit_exceeded")
"""Codes for a number beyond a limit."""


def can_be_asked(at: Rig, asked: Asked) -> bool:
    """Tell whether the subject has bound the operation of a call, with all the inputs that it may lack."""
    further = asked.inputs.keys() & {*protocols()[at.protocol].operations[asked.operation].voluntary_inputs}
    return at.subject.claims(asked.operation) and all(
        at.subject.accepts_input(asked.operation, name) for name in further
    )


async def is_written(at: Rig, reply: Reply, asked: Asked, requirement: str) -> list[Finding]:
    """Expect that the device holds what was written, or has seen the request where it holds nothing."""
    image: Any = await at.device.image()
    if asked.points.keys() <= image["points"].keys():
        return citing(requirement, witness(at).holds(image, asked.points))
    entries = await asked_of_the_device(at, asked, reply)
    return written_once(at, asked, reply, entries, requirement=requirement)


async def refused(
    run: Repetition,
    at: Rig,
    call: Callable[..., Awaitable[Reply]],
    asked: Asked,
    *codes: str,
    requirement: str,
    until_ns: float = math.inf,
) -> None:
    """Expect that a write is refused before anything is sent, and that its targets are as they were.

    Args:
        until_ns: monotonic; a write that was answered later may be a success.
    """
    # The proof of a new session sets values of its own.
    await at.prove_first()
    before: Any = await at.device.image()
    reply = await call(asked.operation, **asked.inputs)
    if reply.success and (reply.exchange.received_ns or math.inf) >= until_ns:
        return
    run.fails(reply, *codes, outcome=NOTHING_SENT, requirement=requirement)
    run.witnessed(nothing_arrived(at, since(reply, await at.journal()), requirement=requirement))
    held = {point: before["points"][point] for point in asked.points if point in before["points"]}
    run.witnessed(citing(requirement, witness(at).holds(await at.device.image(), held)))


def whole(value: float) -> float:
    """Return a whole number as one, as tools for whole numbers want it."""
    return int(value) if value == int(value) else value


def beyond(way: Callable[[float], Asked], value: float) -> list[Asked]:
    """Return the write of a number beyond a limit; none where the target's type has no such number, which WR-004 asks for."""
    try:
        return [way(whole(value))]
    except (struct.error, OverflowError):
        return []


@dataclass(frozen=True, slots=True)
class Fenced:
    """What an adapter with a policy may write, and what it may not.

    Attributes:
        inside, outside: writes of targets that the policy allows without asking, and of targets that it does not name.
        way: makes the write of a number that a person has to approve; None where there is none.
    """

    inside: Sequence[Asked]
    outside: Sequence[Asked]
    way: Callable[[float], Asked] | None


def fenced(run: Repetition, at: Rig) -> Fenced:
    """Return writes within and beyond the policy of the launch with one; without any the check does not apply."""
    asks, told = exercise(at), at.subject.governance
    assert asks.fenced is not None
    target = None if told.approval is None else asks.limited.get(told.approval["target"])
    ways = [way for way in target.ways if can_be_asked(at, way(1))] if target is not None else []
    apart = {point for way in ways for point in way(1).points}
    every = [one for one in asks.fenced(run.rng) if can_be_asked(at, one) and apart.isdisjoint(one.points)]
    inside = [asked for asked in every if all(map(told.bounds.allows, asked.points))]
    outside = [asked for asked in every if asked not in inside]
    if not (inside and outside):
        run.not_applicable("the policy allows none, or all, of the targets that the kit can write")
    return Fenced(inside, outside, ways[0] if ways else None)


def approved_numbers(run: Repetition, at: Rig, count: int) -> list[float]:
    """Return so many numbers within the limits of the target that a person approves, no two of them the same."""
    told = at.subject.governance
    assert told.approval is not None
    limit, unit = told.bounds.limits[told.approval["target"]], exercise(at).limited[told.approval["target"]].unit
    assert limit.lowest is not None
    assert limit.highest is not None
    steps = range(1, int((limit.highest - limit.lowest) / unit))
    return [whole(limit.lowest + unit * step) for step in run.rng.sample(steps, count)]


def taken(at: Rig, asked: Asked, arguments: Mapping[str, object]) -> list[Mapping[str, object]]:
    """Return which of these arguments to give together: those that the tool lists, which it might refuse with others, or else all of them.
    None where the arguments of the call cannot be changed."""
    if at.arguments_of(asked.operation, **asked.inputs) is None:
        return []
    schema = (at.listing(asked.operation, at.tool_of(asked.operation, **asked.inputs) or "") or {}).get("inputSchema")
    listed = {name: value for name, value in arguments.items() if name in properties(schema)}
    return [listed or arguments]


async def written(run: Repetition, at: Rig, asked: Asked, *, requirement: str) -> Reply:
    """Expect that a write succeeds, and that the device has it."""
    reply = await at.call(asked.operation, **asked.inputs)
    if run.succeeds(reply, requirement=requirement):
        run.witnessed(await is_written(at, reply, asked, requirement))
    return reply


@asynccontextmanager
async def another(at: Rig, *, viewer: bool = False, can_ask: bool = True) -> AsyncIterator[None]:
    """Be another caller, or a client that cannot be asked, for the last steps of a check."""
    await at.session.next_is(viewer=viewer, can_ask=can_ask)
    try:
        await at.fresh_session()
        yield
    finally:
        await at.session.next_is()
        await at.close_session()
