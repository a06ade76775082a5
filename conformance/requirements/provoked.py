"""Calls that provoke every kind of answer: success, refusal by the adapter, refusal by the device, a broken connection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from . import generated
from .steps import (
    CONNECTION_FAULTS,
    a_write_works,
    answers_again,
    can_read,
    exercise,
    it_answers,
    read,
    some_write,
    write,
)

__all__ = [
    "UNKNOWN_ARGUMENT",
    "VALIDATION",
    "broken",
    "every_kind",
    "expect_failure",
    "met",
    "needs_envelopes",
    "refused_by_the_adapter",
    "refused_by_the_device",
    "wrongly_asked",
]

UNKNOWN_ARGUMENT = "otmcp_no_such_argument"

VALIDATION = ("invalid_input", "type_mismatch", "range_overflow", "limit_exceeded")
"""Codes for arguments that an adapter refuses by itself."""


def needs_envelopes(run: Repetition, at: Rig) -> None:
    """End the repetition for a subject that does not claim to answer in envelopes."""
    if not at.subject.native:
        run.not_applicable("the subject does not claim to answer in envelopes")


async def wrongly_asked(run: Repetition, at: Rig) -> Reply | None:
    """Write without any argument; return None where no tool call is known that could be changed."""
    asked = exercise(at).write(run.rng)
    arguments = at.arguments_of(asked.operation, **asked.inputs)
    if not arguments or _may_be_left_out(at, asked, arguments):
        return None
    altered = Alteration(left_out=tuple(sorted(arguments.values())))
    return await at.call_altered(asked.operation, altered, **asked.inputs)


def _may_be_left_out(at: Rig, asked: Asked, arguments: Mapping[str, str]) -> bool:
    """Tell whether a named command needs none of its arguments: a light that is switched on is as bright as it was."""
    tool = at.tool_of(asked.operation, **asked.inputs)
    listing = at.listing(asked.operation, tool) if tool is not None and at.by_command_alone(asked.operation) else None
    needed = None if listing is None else generated.required(listing.get("inputSchema"))
    return needed is not None and not set(needed) & set(arguments.values())


async def refused_by_the_adapter(run: Repetition, at: Rig) -> Reply | None:
    """Write without any argument, and expect a failure, whatever its code."""
    reply = await wrongly_asked(run, at)
    if reply is not None:
        expect_failure(run, reply, requirement="MCP-007")
    return reply


async def refused_by_the_device(run: Repetition, at: Rig) -> Reply:
    """Read while the device refuses it, and expect a failure, whatever its code.

    An adapter may get at its data in another way, which the device does not refuse: then nothing is expected. Nor is it of a status: a
    device that refuses answers, so it can be reached.
    """
    await at.device.fault(*exercise(at).refused)
    asked, reply = await read(run, at)
    await at.device.fault()
    known = protocols()[at.protocol]
    own = asked.operation
    if not known.operations[own].status and await met(at, reply):
        if known.exercise is not None and at.subject.blocks(own):
            # A call that waits has subscribed for itself.
            own = known.exercise.reading
        expect_failure(run, reply, requirement=known.operations[own].requirement)
    return reply


async def met(at: Rig, reply: Reply) -> bool:
    """Tell whether the device applied a fault to a request of this call."""
    return any("fault" in entry for entry in reply.during(await at.journal()))


async def broken(run: Repetition, at: Rig, *, requirement: str) -> Reply:
    """Write while the device resets the connection instead of answering, once; afterwards a read works again.

    An adapter that delivers the message again, where the protocol lets it, may succeed.
    """
    await at.device.fault(*({**rule, "times": 1} for rule in exercise(at).reset))
    _, reply = await write(run, at)
    await at.device.fault()
    if not reply.success:
        run.fails(reply, *CONNECTION_FAULTS, requirement=requirement)
    await answers_again(run, at)
    return reply


async def every_kind(run: Repetition, at: Rig) -> Sequence[Reply]:
    """Provoke every kind of answer for which the subject has operations; each envelope is judged as such. Return the failures."""
    await it_answers(run, at)
    reads, writes = can_read(run, at), some_write(run, at) is not None
    refused = by_device = lost = None
    if writes:
        await a_write_works(run, at)
        refused = await refused_by_the_adapter(run, at)
    if reads:
        by_device = await refused_by_the_device(run, at)
    if reads and writes:
        lost = await broken(run, at, requirement="ERR-005")
    return [reply for reply in (refused, by_device, lost) if reply is not None and not reply.success]


def expect_failure(run: Repetition, reply: Reply, *, requirement: str) -> bool:
    """Expect that a call is answered by a failure, in whatever form; return whether it was."""
    if reply.success is False:
        return run.judge(reply, [])
    finding = Finding(
        code="not_refused",
        message=f"{reply.label}: it should have failed, "
        + ("it claims success" if reply.success else "there is no answer that says so"),
        requirement=requirement,
    )
    return run.judge(reply, [finding])
