"""Two tasks on the toy over TCP."""

from __future__ import annotations

from otmcp_toy.steps import guarded, read, write
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Tasks

TASKS = Tasks()


@TASKS.task("T1", "normal", "Read a register.", needs="toy.read", capability="reading", requirements="RD-001")
async def read_register(run: Repetition, toy: Rig) -> None:
    await read(run, toy)


@TASKS.task(
    "T2", "normal", "Write a register.", needs="toy.write", guards="toy", capability="writing", requirements="WR-001"
)
async def write_register(run: Repetition, toy: Rig) -> None:
    await write(run, toy)


@write_register.after
async def nothing_is_written_with_writes_disabled(run: Repetition, toy_ro: Rig | None) -> None:
    await guarded(run, toy_ro)
