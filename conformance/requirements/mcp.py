"""MCP: the session and its tools, whatever the adapter talks to."""

from __future__ import annotations

from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

from .steps import a_write_works, exercise, refused_before_the_wire

__all__ = ["TASKS"]

TASKS = Checks()

_UNKNOWN = "otmcp_no_such_argument"


@TASKS.every_protocol("MCP-004", "An argument that the tool does not have is refused, not ignored.", writes=True)
async def unknown_arguments_are_refused(run: Repetition, at: Rig) -> None:
    """Write with one argument too many; then write the same without it.

    Said: a failure with `invalid_input` and the outcome `not_sent`; then success.
    Seen: no request that changes the plant; then one.
    Why: an assistant that spells `unit` for `slave_id` would command another device than it meant.
    """
    asked = exercise(at).write(run.rng)
    if at.tool_of(asked.operation, **asked.inputs) is None:
        run.not_applicable(f"{asked.operation} is not performed by one tool call")
    altered = Alteration(given={_UNKNOWN: 7})
    reply = await at.call_altered(asked.operation, altered, **asked.inputs)
    await refused_before_the_wire(run, at, reply, "invalid_input", requirement="MCP-004")
    await a_write_works(run, at)
