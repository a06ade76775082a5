"""Reads by the named readings of an adapter."""

from __future__ import annotations

from dataclasses import replace

from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.unsolicited import nothing_commanded
from pytest_otmcp.trial.named_readings import apart, asked_of
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from ..within import allowed
from .common import fresh, some_exchange

__all__ = ["reads_by_name", "told_at_once", "told_in_turn"]


def reads_by_name(at: Rig, *operations: str) -> bool:
    """Tell whether an adapter performs the first of these operations that it has by named readings alone."""
    claimed = next((name for name in operations if at.subject.claims(name)), None)
    return claimed is not None and at.by_command_alone(claimed)


async def told_in_turn(run: Repetition, at: Rig, calls: int) -> None:
    """Call named readings so many times, one after the other, and expect what was set at random just before each call; and nothing that
    changes the plant."""
    replies: list[Reply] = []
    for place in range(calls):
        asked = _one_of(run, at, place)
        await _set(at, asked)
        replies.append(await at.call(asked.operation, **asked.inputs))
        run.succeeds(replies[-1], **asked.outputs)
    journal = await at.journal()
    run.witnessed(
        fresh(journal, *((reply, some_exchange(at)) for reply in replies)),
        [
            replace(finding, requirement="MCP-008")
            for finding in nothing_commanded(at.protocol, journal, at.subject.declared)
        ],
    )


async def told_at_once(run: Repetition, at: Rig, calls: int) -> None:
    """Call named readings so many times, at the same time, and expect in each answer what was set at random at its own place."""
    different = apart(_one_of(run, at, place) for place in range(calls))
    for one in different:
        await _set(at, one)
    asked = [different[place % len(different)] for place in range(calls)]
    replies = await run.together(*(at.call(one.operation, **one.inputs) for one in asked))
    for one, reply in zip(asked, replies, strict=True):
        run.succeeds(reply, **one.outputs)
    run.witnessed(fresh(await at.journal(), *((reply, some_exchange(at)) for reply in replies)))


def _one_of(run: Repetition, at: Rig, place: int) -> Asked:
    """Return the read of one of the places that the readings know, each in its turn, which holds a value that is drawn at random."""
    known = [(operation, one, inputs) for operation, one in at.readings() for inputs in one.examples()]
    every = [asked_of(at.protocol, operation, inputs, one.held(run.rng)) for operation, one, inputs in known]
    fit = [asked for asked in every if allowed(at, asked)] or every
    return fit[place % len(fit)]


async def _set(at: Rig, asked: Asked) -> None:
    for poke in asked.pokes:
        await at.device.poke(**poke)
