"""WR: named commands, whose effect on the device the subject file states."""

from __future__ import annotations

from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

from ..within import allowed
from .steps import asked_of_the_device, citing, exercise, witness, written_once

__all__ = ["TASKS"]

TASKS = Checks()


@TASKS.every_protocol(
    "WR-014", "A named command does what the subject file states.", reads=False, writes=True, facets="commands"
)
async def commands_have_their_effect(run: Repetition, at: Rig) -> None:
    """Call every named command with every value of a list, with both ends of a range and with a value within it.

    Said: success.
    Seen: one request for each call, with the effect that the subject file states; where the device holds values, it holds these, and
        everything else is as it was.
    Why: an assistant knows a lamp or a pump by its name alone, and cannot see which register that is.
    """
    await at.prove()
    for asked in _every_command(run, at):
        before = await at.image()
        reply = await at.call(asked.operation, **asked.inputs)
        if not run.succeeds(reply, requirement="WR-014"):
            continue
        seen = await asked_of_the_device(at, asked, reply)
        run.witnessed(written_once(at, asked, seen, requirement="WR-014"))
        if asked.points:
            run.witnessed(citing("WR-014", witness(at).only_changed(before, await at.image(), asked.points)))


def _every_command(run: Repetition, at: Rig) -> list[Asked]:
    """Return a call for each example of each command, as far as the schema of its tool allows it, and one with values drawn at random."""
    points_of = exercise(at).points_of
    every = [
        Asked(operation=operation, inputs=inputs, points=points_of(operation, inputs))
        for operation, command in at.commands()
        for inputs in (*command.examples(), command.drawn(run.rng))
    ]
    return [asked for asked in every if allowed(at, asked)]
