"""RD: named readings, whose source at the device the subject file states."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.named_readings import apart, asked_of, place_of
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Command, Rig

from ..within import allowed, exercise
from .provoked import expect_failure
from .steps import answered, letters, relayed

__all__ = ["TASKS"]

TASKS = Checks()

_DRAWN = 30
"""Calls of each reading with arguments and values that are drawn at random."""
_OTHER_NUMBERS = 50
"""Numbers among which there is one that no word stands for."""


@TASKS.every_protocol("RD-008", "A named reading tells what the device holds.", reads=False, facets="readings")
async def readings_tell_what_the_device_holds(run: Repetition, at: Rig) -> None:
    """Call every named reading with every value of a list, and with the ends of a range, while each place that it can read holds another value;
    while it holds the lowest, and the highest, that it may hold; and many times with values drawn at random, some of them near zero. Call it while
    the device refuses every read, or says that its value is bad; while a floating-point number is none; and while a number is held that no word
    of the subject file stands for.
    Give an argument that takes a few words one that stands for nothing, and one of them between other letters. Call each reading while the
    device is away.

    Said: what the device holds, by the meaning that the subject file states; a failure of what the device has refused or calls bad, of a
        word that stands for nothing, and while the device is away. What is no number is not told as one, and a number without a word not by a known word.
    Seen: the device answers at least one request during each call that succeeds.
    Why: an assistant knows a sensor or a tank by its name alone, and cannot see which register that is, nor its scale.
    """
    every = [(operation, reading, _every(run, at, operation, reading)) for operation, reading in at.readings()]
    called = [(operation, reading, asked) for operation, reading, asked in every if asked]
    for operation, reading, places in called:
        different = apart(places)
        for asked in different:
            await _set(at, asked)
        for asked in different:
            await _tells(run, at, asked)
        for asked in places:
            if asked not in different:
                await _set(at, asked)
                await _tells(run, at, asked)
        inputs = places[0].inputs
        drawn = [(reading.drawn(run.rng), reading.held_anywhere(run.rng)) for _ in range(_DRAWN)]
        for given, value in [*((inputs, end) for end in reading.held_at_most()), *drawn]:
            asked = asked_of(at.protocol, operation, given, value)
            if allowed(at, asked):
                await _set(at, asked)
                await _tells(run, at, asked)
        await _refused(run, at, places[0])
        await _told_as_nothing_known(run, at, operation, places[0])
        for name in reading.words():
            await _no_such_word(run, at, places[0], reading, name)
    if called and at.subject.claims("recovery") and at.subject.reconnects:
        await _away(run, at, [places[0] for _, _, places in called])


def _every(run: Repetition, at: Rig, operation: str, reading: Command) -> list[Asked]:
    """Return calls that read different places, as far as the schema of the tool allows them."""
    asked = [asked_of(at.protocol, operation, one, reading.held(run.rng)) for one in reading.examples()]
    return [one for one in asked if allowed(at, one)]


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


async def _told_as_nothing_known(run: Repetition, at: Rig, operation: str, asked: Asked) -> None:
    """Set what has no meaning by the subject file, and expect that it is not told as what has one."""
    place = place_of(at.protocol, operation, asked.inputs)
    if unsound := place.unsound(next(iter(asked.points.values()))):
        for poke in unsound:
            await at.device.poke(**poke)
        expect_failure(run, await at.call(operation, **asked.inputs), requirement="RD-008")
        await _set(at, asked)
    held = place.kind
    words = at.words_of(operation, **asked.inputs)
    strange: list[object] = [math.nan, math.inf] if not held.is_whole and held.form in ("f", "d") else []
    if words and held.is_whole:
        strange = [next(number for number in range(_OTHER_NUMBERS) if number not in words)]
    for value in strange:
        unknown = asked_of(at.protocol, operation, asked.inputs, value)
        await _set(at, unknown)
        reply = await at.call(operation, **asked.inputs)
        (found,) = (reply.outputs.get(name) for name in unknown.outputs)
        told = found[0] if isinstance(found, list) and found else found
        if reply.success and (told in words if words else isinstance(told, int | float)):
            said = f"while the device held {value!r}, which has no meaning, the reply means that it holds {told!r}"
            finding = Finding(code="wrong_value", message=f"{reply.label}: {said}", requirement="RD-008")
            run.judge(reply, [finding])
    await _set(at, asked)


async def _no_such_word(run: Repetition, at: Rig, asked: Asked, reading: Command, name: str) -> None:
    """Give an argument a word that stands for nothing, and a known word between other letters, and expect that none is taken for a known one."""
    argument, values = at.argument_drawn(asked.operation, name, **asked.inputs), reading.arguments(asked.inputs)
    if argument is None or values is None:
        return
    for word in (letters(run), f"{values[name]} {letters(run)}", f"{letters(run)} {values[name]}"):
        reply = await at.call_altered(asked.operation, Alteration(given={argument: word}), **asked.inputs)
        expect_failure(run, reply, requirement="RD-008")


async def _away(run: Repetition, at: Rig, asked: Sequence[Asked]) -> None:
    """Expect that no reading tells anything while the device is away, and that one does when it is back."""
    await at.stop_device()
    await at.call_until_failure(asked[0].operation, window_s=1.0, **asked[0].inputs)
    for one in asked:
        expect_failure(run, await at.call(one.operation, **one.inputs), requirement="RD-008")
    await at.start_device()
    await _set(at, asked[0])
    window_s = at.subject.recovery_s
    replies = await at.call_until_success(asked[0].operation, window_s=window_s, **asked[0].inputs)
    run.succeeds(replies[-1], requirement="REC-001")
