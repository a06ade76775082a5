"""RD: named readings, whose source at the device the subject file states."""

from __future__ import annotations

from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.named_readings import asked_of
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Command, Rig

from ..within import allowed, exercise
from .provoked import expect_failure
from .steps import answered, letters, relayed

__all__ = ["TASKS"]

TASKS = Checks()

_DRAWN = 3
"""Calls of each reading with arguments that are drawn at random."""


@TASKS.every_protocol("RD-008", "A named reading tells what the device holds.", reads=False, facets="readings")
async def readings_tell_what_the_device_holds(run: Repetition, at: Rig) -> None:
    """Call every named reading with every value of a list, with the ends of a range, and with values drawn at random, while each place that it
    can read holds another value; once more while it holds the lowest, and the highest, that it may hold. Call it while the device refuses
    every read. Give an argument that takes a few words one of them between other letters.

    Said: what the device holds, by the meaning that the subject file states; a failure of what the device has refused, and of a word that
        stands for nothing.
    Seen: the device answers at least one request during each call.
    Why: an assistant knows a sensor or a tank by its name alone, and cannot see which register that is, nor its scale.
    """
    for operation, reading in at.readings():
        every = _every(run, at, operation, reading)
        if not every:
            continue
        for asked in every:
            await _set(at, asked)
        for asked in every:
            await _tells(run, at, asked)
        for asked in (asked_of(at.protocol, operation, every[0].inputs, end) for end in reading.held_at_most()):
            await _set(at, asked)
            await _tells(run, at, asked)
        await _refused(run, at, every[0])
        for name in reading.words():
            await _no_such_word(run, at, every[0], reading, name)


def _every(run: Repetition, at: Rig, operation: str, reading: Command) -> list[Asked]:
    """Return calls that read different places, as far as the schema of the tool allows them."""
    inputs = [*reading.examples(), *(reading.drawn(run.rng) for _ in range(_DRAWN))]
    asked = [asked_of(at.protocol, operation, one, reading.held(run.rng)) for one in inputs]
    places = {str(one.inputs): one for one in asked if allowed(at, one)}
    return list(places.values())


async def _set(at: Rig, asked: Asked) -> None:
    for poke in asked.pokes:
        await at.device.poke(**poke)


async def _tells(run: Repetition, at: Rig, asked: Asked) -> None:
    reply = await at.call(asked.operation, **asked.inputs)
    if run.succeeds(reply, requirement="RD-008", **asked.outputs):
        run.witnessed(answered(at, reply.during(await at.journal()), requirement="RD-008"))


async def _refused(run: Repetition, at: Rig, asked: Asked) -> None:
    await at.device.fault(*exercise(at).refused)
    reply = await at.call(asked.operation, **asked.inputs)
    await at.device.fault()
    if relayed(at, reply.during(await at.journal())):
        expect_failure(run, reply, requirement="RD-008")


async def _no_such_word(run: Repetition, at: Rig, asked: Asked, reading: Command, name: str) -> None:
    """Give an argument a known word between other letters, and expect that it is not taken for that word."""
    argument, values = at.argument_drawn(asked.operation, name, **asked.inputs), reading.arguments(asked.inputs)
    if argument is None or values is None:
        return
    for word in (f"{values[name]} {letters(run)}", f"{letters(run)} {values[name]}"):
        reply = await at.call_altered(asked.operation, Alteration(given={argument: word}), **asked.inputs)
        expect_failure(run, reply, requirement="RD-008")
