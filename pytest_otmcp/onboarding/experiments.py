"""Experiments that are the same for every protocol: a read of random values that were set before, and a write that the device has to see."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping

from ..core.finding import Finding
from ..protocols.exercise import Asked
from ..protocols.journal import Entries, Image
from ..protocols.registry import protocols
from .experimenter import Experiment, Experimenter
from .guess import Guess
from .proposal import Proposal

__all__ = ["every_write", "reading", "writing"]

Make = Callable[[random.Random], Asked]


def reading(
    make: Make,
    reached: Callable[[Entries, Image, Asked], bool],
    *,
    echoes: Mapping[str, object] | None = None,
    missing: Asked | None = None,
) -> Experiment:
    """Return the experiment with a tool that reads.

    Args:
        make: the read, with values that cannot be mistaken for anything else.
        reached: tells whether requests for what a call reads reached the device.
        echoes: further outputs, with the values that an answer may have for them.
        missing: a read of what the device does not have.
    """

    async def experiment(experimenter: Experimenter, guess: Guess) -> Proposal:
        asked = make(experimenter.random)
        for poke in asked.pokes:
            await experimenter.device.poke(**poke)
        shown = await experimenter.call(guess, {}, **asked.inputs)
        proven = reached(shown.entries, await experimenter.device.image(), asked)
        proposal = experimenter.propose(guess, shown, proven=proven)
        for output, value in asked.outputs.items():
            experimenter.locate(proposal, output, value)
        if proven:
            for output, value in (echoes or {}).items():
                experimenter.locate_echo(proposal, output, value)
            if missing is not None:
                experimenter.provoke(proposal, "illegal_address", **missing.inputs)
        return proposal

    return experiment


def writing(
    make: Make,
    one_write: Callable[[Entries, Image, Asked], list[Finding]],
    *,
    refused: tuple[str, Asked],
    after: Mapping[str, object] | None = None,
) -> Experiment:
    """Return the experiment with a tool that writes.

    Args:
        make: the write.
        one_write: expects that the device saw the one write of a call.
        refused: a write that has to fail, and the code of that failure.
        after: what is set at the mock afterwards, so that the target is free for the experiments that follow.
    """

    async def experiment(experimenter: Experimenter, guess: Guess) -> Proposal:
        asked = make(experimenter.random)
        shown = await experimenter.call(guess, {}, **asked.inputs)
        proven = not one_write(shown.entries, await experimenter.device.image(), asked)
        proposal = experimenter.propose(guess, shown, proven=proven)
        if proven:
            for output, value in asked.outputs.items():
                experimenter.locate_echo(proposal, output, value)
            experimenter.provoke(proposal, refused[0], **refused[1].inputs)
        if after is not None:
            await experimenter.device.poke(**after)
        return proposal

    return experiment


def every_write(operation: str) -> Experiment:
    """Return the experiment with a tool that writes what the protocol's exercise has for an operation, with the offsets of other tools."""

    async def experiment(experimenter: Experimenter, guess: Guess) -> Proposal:
        exercise = protocols()[experimenter.adapter.adapter.protocol].exercise
        assert exercise is not None
        assert exercise.every_write is not None
        asked = next(one for one in exercise.every_write(experimenter.random) if one.operation == operation)
        shown = []
        for offset in experimenter.offsets:
            for poke in asked.pokes:
                await experimenter.device.poke(**poke)
            shown.append(await experimenter.call(guess, offset, **asked.inputs))
            if await experimenter.was_done(asked, shown[-1]):
                return experimenter.propose(guess, shown[-1], proven=True, offset=offset)
        return experimenter.propose(guess, shown[0], proven=False)

    return experiment
