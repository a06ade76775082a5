"""WR: named commands, whose effect on the device the subject file states."""

from __future__ import annotations

from collections.abc import Iterator

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Command, Rig

from ..commanded import carried_out, done
from ..within import allowed, commanding, exercise
from .provoked import expect_failure
from .steps import faulty, letters, nothing_arrived, refusal, relayed

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
    Give an argument that takes a few words one that stands for nothing, and one of them between other letters.

    Said: success, with the arguments and the effect as they were asked for, where the subject file states what the answer says of them; a
        failure of what the device has refused, and of a word that stands for nothing.
    Seen: one request for each call, with the effect that the subject file states, or one for each of its effects, in their order; where the
        device holds values, it holds these, and everything else is as it was. Nothing of a word that only holds a known one.
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
    for operation, command in at.commands():
        for name in _words(at, operation, command):
            await _no_such_word(run, at, operation, command, name)


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


def _words(at: Rig, operation: str, command: Command) -> Iterator[str]:
    """Return the arguments that say by a word what is to be done. One that says where, such as the name of a lamp in a topic, may be made
    into a name that only the plant knows."""
    known = protocols()[at.protocol].operations
    for name in command.words():
        made = command.inputs_of(name, operation)
        if not _is_text(command, name) or any(given in known[performed].documents for performed, given in made):
            yield name


def _is_text(command: Command, name: str) -> bool:
    draw = command.draws[name]
    return any(isinstance(meaning, str) for meaning in draw.means or draw.values)


async def _no_such_word(run: Repetition, at: Rig, operation: str, command: Command, name: str) -> None:
    """Give an argument a word that stands for nothing, and a known word between other letters, and expect that none is taken for a known one."""
    inputs = command.drawn(run.rng)
    argument, values = at.argument_drawn(operation, name, **inputs), command.arguments(inputs)
    if argument is None or values is None or not allowed(at, commanding(at, exercise(at), operation, inputs)):
        return
    known = [
        commanding(at, exercise(at), operation, command.effect_of({**values, name: word}))
        for word in command.draws[name].values
    ]
    for word in (letters(run), f"{values[name]} {letters(run)}", f"{letters(run)} {values[name]}"):
        await at.prove()
        reply = await at.call_altered(operation, Alteration(given={argument: word}), **inputs)
        entries = reply.during(await at.journal())
        if not _is_text(command, name):
            expect_failure(run, reply, requirement="WR-014")
            run.witnessed(nothing_arrived(at, entries, requirement="WR-014"))
        elif any(done(at, asked, entries) for asked in known):
            message = f"{reply.label}: {word!r} is none of its words, and the device saw the effect of one"
            evidence = protocols()[at.protocol].seen(entries)
            run.judge(reply, [Finding(code="wrote", message=message, requirement="WR-014", evidence=evidence)])
        else:
            run.judge(reply, [])


def _every_command(run: Repetition, at: Rig) -> list[Asked]:
    """Return calls of each command, as far as the schemas of their tools allow them."""
    every = [
        commanding(at, exercise(at), operation, inputs)
        for operation, command in at.commands()
        for inputs in (*command.examples(), *(command.drawn(run.rng) for _ in range(_DRAWN)))
    ]
    return [asked for asked in every if allowed(at, asked)]
