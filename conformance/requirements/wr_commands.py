"""WR: named commands, whose effect on the device the subject file states."""

from __future__ import annotations

from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

from ..commanded import carried_out
from ..within import allowed, commanding, exercise
from .provoked import expect_failure
from .steps import faulty, refusal, relayed

__all__ = ["TASKS"]

TASKS = Checks()

_DRAWN = 5
"""Calls of each command with values that are drawn at random."""


@TASKS.every_protocol(
    "WR-014", "A named command does what the subject file states.", reads=False, writes=True, facets="commands"
)
async def commands_have_their_effect(run: Repetition, at: Rig) -> None:
    """Call every named command with every value of a list, with the ends of a range, and with values drawn at random. Call each again with
    the same values, after somebody else has changed what it did. Call one of several effects while the device refuses every write, if it can.

    Said: success; a failure of what the device has refused.
    Seen: one request for each call, with the effect that the subject file states, or one for each of its effects, in their order; where the
        device holds values, it holds these, and everything else is as it was.
    Why: an assistant knows a lamp or a pump by its name alone, and cannot see which register that is.
    """
    for asked in _every_command(run, at):
        await carried_out(run, at, asked, requirement="WR-014")
    for operation, command in at.commands():
        asked = commanding(at, exercise(at), operation, command.drawn(run.rng))
        if allowed(at, asked):
            await _once_more(run, at, asked)
    for operation, command in at.commands():
        asked = commanding(at, exercise(at), operation, command.drawn(run.rng))
        # A command of one effect stands for a write in the rows about refusals.
        if asked.then and allowed(at, asked):
            await _refused(run, at, asked)


async def _once_more(run: Repetition, at: Rig, asked: Asked) -> None:
    """Carry a command out twice. Between the calls the device is changed, where it holds what is written: an adapter that has read first
    may have found it there already."""
    held = exercise(at).held
    adds = protocols()[at.protocol].operations[asked.operation].adds
    if not adds and (held is None or not asked.points):
        return
    await carried_out(run, at, asked, requirement="WR-014")
    if held is not None:
        for point, value in asked.points.items():
            await at.device.poke(**held(point, value))
    await carried_out(run, at, asked, requirement="WR-014")


async def _refused(run: Repetition, at: Rig, asked: Asked) -> None:
    await at.prove()
    await at.device.fault(*faulty(exercise(at).writes, **refusal(at)))
    reply = await at.call(asked.operation, **asked.inputs)
    await at.device.fault()
    if relayed(at, reply.during(await at.journal())):
        expect_failure(run, reply, requirement="WR-014")


def _every_command(run: Repetition, at: Rig) -> list[Asked]:
    """Return calls of each command, as far as the schemas of their tools allow them."""
    every = [
        commanding(at, exercise(at), operation, inputs)
        for operation, command in at.commands()
        for inputs in (*command.examples(), *(command.drawn(run.rng) for _ in range(_DRAWN)))
    ]
    return [asked for asked in every if allowed(at, asked)]
