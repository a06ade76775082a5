"""A named command, called and judged by the effect that the subject file states. Tasks and checks share it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import THEN, Asked
from pytest_otmcp.protocols.journal import Entries, JournalEntry
from pytest_otmcp.protocols.oracle import Witness
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.protocols.unsolicited import nothing_commanded
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from .within import exercise

__all__ = ["asked_of_the_device", "carried_out", "done", "guarded", "nothing_sent", "some_command"]

_LATE_S = 0.25
"""Seconds for which a message that no answer confirms may be on its way when the call is answered."""


def some_command(run: Repetition, at: Rig) -> Asked:
    """Make the write of an adapter that writes by named commands alone, with values drawn at random."""
    return exercise(at).write(run.rng)


async def asked_of_the_device(at: Rig, asked: Asked, reply: Reply) -> Entries:
    """Return what reached the device during a call that writes; of a named command, and of a success that the device had seen nothing of,
    also what has come since.

    What needs no answer, as a message of QoS 0, may be on its way when the call is answered.
    """
    several, entries = at.by_command_alone(asked.operation) or asked.then, await at.journal()
    seen = done(at, asked, _since(reply, entries) if several else reply.during(entries))
    if not several and (seen or not reply.success):
        return reply.during(entries)
    if reply.success and len(seen) < 1 + len(asked.then):
        await at.watch(_LATE_S)
    return _since(reply, await at.journal() if reply.success else entries)


async def carried_out(run: Repetition, at: Rig, asked: Asked, *, requirement: str | None = None) -> None:
    """Call a command, and expect success, one request with its effect, or one with each of its effects in their order, and nothing else
    at the device.

    Args:
        requirement: id of the requirement that anything else breaks; None is WR-001 to WR-003, depending on what it is.
    """
    await at.prove()
    before = await at.device.image()
    reply = await at.call(asked.operation, **asked.inputs)
    # What an answer says wrongly excuses nothing that the device saw.
    if not run.succeeds(reply, requirement=requirement) and not reply.success:
        return
    seen = await asked_of_the_device(at, asked, reply)
    found, parts = done(at, asked, seen), (asked, *asked.then)
    wrong = next(
        (
            (part, shown)
            for part, entry in zip(parts, found, strict=False)
            if (shown := _sent_otherwise(at, part, entry))
        ),
        None,
    )
    if (problem := _not_as_stated(at, asked, found)) is not None:
        broken = requirement or ("WR-003" if len(found) > len(parts) else "WR-001")
        message = f"{reply.label}: the device should have seen {problem}"
        run.finding("not_written_once", message, broken, evidence=protocols()[at.protocol].seen(seen))
    elif wrong is not None:
        part, shown = wrong
        message = f"{reply.label}: the device should have seen one request with {dict(part.sent)}, it saw {shown}"
        run.finding("not_written_once", message, requirement or "WR-001", evidence=protocols()[at.protocol].seen(seen))
    if asked.points:
        witness = Witness(noun="the device", describe=protocols()[at.protocol].describe)
        changed = witness.only_changed(before, await at.device.image(), asked.points)
        run.witnessed([replace(finding, requirement=requirement or finding.requirement) for finding in changed])


def done(at: Rig, asked: Asked, entries: Entries) -> list[JournalEntry]:
    """Return the requests that ask the device for the effect of a call, or for any of its effects."""
    known = exercise(at)
    if not asked.then:
        return known.done(entries, asked)
    parts = (asked, *asked.then)
    return [
        entry
        for entry in protocols()[at.protocol].changes(entries)
        if any(known.recognised[part.operation](entry, part) for part in parts)
    ]


def _not_as_stated(at: Rig, asked: Asked, found: Entries) -> str | None:
    """Say, in words that follow "should have seen", in what these requests differ from the effect of a call; None where in nothing."""
    if not asked.then:
        return None if len(found) == 1 else f"its effect, {_effect(asked)}, once, it saw it {len(found)} times"
    parts, recognised = (asked, *asked.then), exercise(at).recognised
    seen = [[recognised[part.operation](entry, part) for part in parts] for entry in found]
    if len(found) == len(parts) and all(of[place] for place, of in enumerate(seen)):
        return None
    expected = f"its effects, {', then '.join(map(_effect, parts))}, each once and in this order, it saw"
    counts = [sum(of[place] for of in seen) for place in range(len(parts))]
    if len(found) == len(parts) and all(counts):
        return f"{expected} them in another order"
    return f"{expected} them {' and '.join(map(str, counts))} times"


def _sent_otherwise(at: Rig, asked: Asked, entry: JournalEntry) -> Mapping[str, object]:
    """Return what a request says beside the value, where it is not what was asked for."""
    known = exercise(at)
    said = None if known.says is None else known.says(entry)
    shown = {} if said is None else {name: said[name] for name in asked.sent if name in said}
    return {} if all(asked.sent[name] == value for name, value in shown.items()) else shown


def _effect(asked: Asked) -> str:
    inputs = {name: value for name, value in asked.inputs.items() if name != THEN}
    return f"{asked.operation} with {', '.join(f'{name}={value!r}' for name, value in inputs.items())}"


async def guarded(run: Repetition, at: Rig, asked: Asked) -> None:
    """Call a command with writes disabled, and expect that it is refused and nothing arrives."""
    reply = await at.call(asked.operation, **asked.inputs)
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.witnessed(nothing_sent(at, _since(reply, await at.journal())))


def nothing_sent(at: Rig, entries: Entries) -> list[Finding]:
    """Expect that nothing among entries commands the plant, whose writes are disabled."""
    return [
        replace(finding, requirement="WR-004")
        for finding in nothing_commanded(at.protocol, entries, at.subject.declared)
    ]


def _since(reply: Reply, entries: Entries) -> Entries:
    return [entry for entry in entries if entry["t_ns"] >= reply.exchange.sent_ns]
