"""Two tasks on the toy over UDP."""

from __future__ import annotations

from otmcp_toy.steps import guarded, read, write
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Tasks

TASKS = Tasks()


@TASKS.task("U1", "normal", "Read a register.", needs="toyudp.read", capability="reading", requirements="RD-001")
async def read_register(run: Repetition, toyudp: Rig) -> None:
    await read(run, toyudp)


@TASKS.task(
    "U2",
    "normal",
    "Write a register.",
    needs="toyudp.write",
    guards="toyudp",
    capability="writing",
    requirements="WR-001",
)
async def write_register(run: Repetition, toyudp: Rig) -> None:
    await write(run, toyudp)


@write_register.after
async def nothing_is_written_with_writes_disabled(run: Repetition, toyudp_ro: Rig | None) -> None:
    await guarded(run, toyudp_ro)
