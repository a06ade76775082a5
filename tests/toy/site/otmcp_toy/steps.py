"""The steps of the tasks of both toys."""

from __future__ import annotations

from otmcp_toy.protocol import WITNESS
from pytest_otmcp.protocols.journal import JournalEntry
from pytest_otmcp.protocols.oracle import has
from pytest_otmcp.protocols.session_oracle import StateChanges
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

__all__ = ["guarded", "read", "write"]


async def read(run: Repetition, toy: Rig) -> None:
    value = run.rng.randrange(1, 1000)
    await toy.device.poke(address=3, value=value)
    run.succeeds(await toy.call("read", address=3), value=value)
    journal = await toy.journal()
    run.witnessed(
        WITNESS.was_asked(journal, "register 3", lambda asked: any(has(one, kind="read", address=3) for one in asked)),
        WITNESS.nothing_changed(journal),
        WITNESS.holds(await toy.device.image(), {"3": value}),
    )


async def write(run: Repetition, toy: Rig) -> None:
    value = 40 + run.rep
    before = await toy.device.image()
    run.succeeds(await toy.call("write", address=1, value=value), value=value)
    journal = await toy.journal()

    def problem(entry: JournalEntry) -> tuple[str, str] | None:
        right = (entry["address"], entry["value"]) == (1, value)
        return None if right else ("WR-001", "it saw another write")

    run.witnessed(
        WITNESS.exactly_one_write(journal, f"write of {value} to 1", problem),
        WITNESS.no_duplicates(journal, identity=lambda entry: (entry["address"], entry["value"])),
        WITNESS.only_changed(before, await toy.device.image(), {"1": value}),
    )


async def guarded(run: Repetition, toy_ro: Rig | None) -> None:
    if toy_ro is None:
        return
    before = await toy_ro.device.image()
    run.fails(await toy_ro.call("write", address=1, value=999), "writes_disabled")
    run.succeeds(await toy_ro.call("read", address=1))
    await toy_ro.close_session()
    run.witnessed(
        WITNESS.answered(await toy_ro.journal()),
        WITNESS.nothing_changed((await toy_ro.follow(StateChanges)).first),
        WITNESS.only_changed(before, await toy_ro.device.image(), {}),
    )
