"""Steps that the checks of several areas share."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from pytest_otmcp.core.error_registry import wire_codes
from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.journal import Entries, JournalEntry
from pytest_otmcp.protocols.oracle import Witness, requests
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.protocols.unsolicited import nothing_commanded
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from ..commanded import asked_of_the_device
from ..tasks.common import CONNECTION_FAULTS, NOTHING_SENT, QUIET_S
from ..within import exercise

__all__ = [
    "CONNECTION_FAULTS",
    "NOTHING_SENT",
    "QUIET_S",
    "a_read_works",
    "a_write_works",
    "answers_again",
    "can_prove",
    "can_read",
    "citing",
    "exact_or_refused",
    "exercise",
    "faulty",
    "it_answers",
    "knows_node",
    "most_characters",
    "nothing_arrived",
    "polls",
    "read",
    "reads_anything",
    "refusal",
    "refused_before_the_wire",
    "reset",
    "said_of_repetitions",
    "silence",
    "since",
    "some_read",
    "some_write",
    "vanishing",
    "witness",
    "works_again",
    "write",
    "written_once",
]

_POLLED_S = 6.0
"""How long is looked for requests that nobody has asked for, before equal requests are held against a call. A question of the adapter's own that
nobody has answered may wait for a whole time-out before it is asked again."""


def can_read(run: Repetition, at: Rig) -> bool:
    """Tell whether the subject has the read of the exercise."""
    asked = exercise(at).read(run.rng)
    return at.can_ask(asked.operation, asked.inputs)


def some_read(run: Repetition, at: Rig) -> Asked | None:
    """Make a read by whichever operation the subject has that the device has to answer, that of the exercise first; None where it has
    none."""
    return next((asked for asked in _reads(at, run.rng) if _is_read(at, asked)), None)


def reads_anything(at: Rig) -> bool:
    """Tell whether the subject has the read of the exercise, a call that takes its place, or a status."""
    return any(_is_read(at, asked) for asked in _reads(at, random.Random(0)))


def _reads(at: Rig, rng: random.Random) -> list[Asked]:
    unreachable = protocols()[at.protocol].proof.unreachable
    others = [Asked(operation=one.operation, inputs=one.made(rng)) for one in unreachable]
    return [exercise(at).read(rng), *others]


def _is_read(at: Rig, asked: Asked) -> bool:
    # A call that does not wait for messages returns what came before, so the device need not be there.
    waits = protocols()[at.protocol].operations[asked.operation].waits
    return at.can_ask(asked.operation, asked.inputs) and (waits is None or at.subject.blocks(asked.operation))


def some_write(run: Repetition, at: Rig) -> Asked | None:
    """Make the exercise's write; None where the subject has no operation for it, or none that proves its session first."""
    asked = exercise(at).write(run.rng)
    provable = can_prove(run, at)
    return asked if at.can_ask(asked.operation, asked.inputs) and provable else None


def can_prove(run: Repetition, at: Rig) -> bool:
    """Tell whether the subject has an operation that proves its session, without which nothing is written."""
    ways = protocols()[at.protocol].proof.ways
    # Each makes its random numbers: what was never asked has no bindings in a record.
    provable = [at.can_ask(way.operation, way.ask(run.rng).inputs) for way in ways]
    return any(provable)


async def it_answers(run: Repetition, at: Rig, *, requirement: str | None = None) -> None:
    """Read by whichever operation the subject has; without any, ask for the list of tools. The session goes on.

    A call before may have cost the connection to the device: then the read may fail until that is there again.
    """
    asked = some_read(run, at)
    if asked is None:
        await at.session.listed_tools()
        return
    await reads_soon(run, at, asked, requirement=requirement)


async def reads_soon(run: Repetition, at: Rig, asked: Asked, *, requirement: str | None = None) -> None:
    """Read until that succeeds, at most for as long as the subject may take to connect again."""
    for poke in asked.pokes:
        await at.device.poke(**poke)
    replies = await at.call_until_success(
        asked.operation, window_s=at.subject.recovery_s, from_first_call=True, **asked.inputs
    )
    run.succeeds(replies[-1], requirement=requirement, **asked.outputs)
    if replies[-1].success and (known := protocols()[at.protocol].exercise) is not None and known.waiting is not None:
        await _over_a_connection_that_lives(run, at, replies[-1], requirement or "REC-001")


def faulty(conditions: Iterable[Mapping[str, object]], **action: object) -> list[Mapping[str, object]]:
    """Return the rules of a fault plan by which every request that meets one of the conditions gets this fault.

    Args:
        conditions: the ``reads`` or ``writes`` of an exercise.
        action: of the rules.
    """
    return [{**condition, "action": action} for condition in conditions]


def relayed(at: Rig, seen: Entries) -> list[str]:
    """Return the error codes of what the device said when it refused."""
    known, refusals = wire_codes(protocols()[at.protocol].package), exercise(at).refusals
    keys = dict.fromkeys(key for entry in seen for key in refusals(entry) if key in known)
    return [code for key in keys for code in known[key].codes]


async def fails_or_relays(
    run: Repetition, at: Rig, reply: Reply, *codes: str, requirement: str, **expected: Any
) -> None:
    """Expect a failure with one of these codes, or with that of what the device itself said: then what the step is about did not come about."""
    if reply.success is False and reply.error_code not in codes:
        told = relayed(at, reply.during(await at.journal()))
        if reply.error_code in told:
            run.fails(reply, *told, requirement=requirement)
            return
    run.fails(reply, *codes, requirement=requirement, **expected)


def silence(at: Rig) -> Mapping[str, object]:
    """Return the action of a fault rule with which the device of this protocol takes a request and never answers."""
    action = exercise(at).silent[0]["action"]
    assert isinstance(action, Mapping)
    return action


def reset(at: Rig) -> Mapping[str, object]:
    """Return the action of a fault rule with which the device resets the connection; over datagrams, that of a lost answer."""
    action = exercise(at).reset[0]["action"]
    assert isinstance(action, Mapping)
    return action


def refusal(at: Rig) -> Mapping[str, object]:
    """Return the action of a fault rule with which the device refuses a write, as far as its protocol can."""
    known = exercise(at)
    action = known.refused[0]["action"] if known.write_refused is None else known.write_refused[0]
    assert isinstance(action, Mapping)
    return action


def vanishing(at: Rig) -> Mapping[str, object]:
    """Return the action of a fault rule with which a request is lost, and with it the connection, where there is one."""
    return {"half_open": True} if protocols()[at.protocol].has_connections else {"lose": True}


def witness(at: Rig) -> Witness:
    """Return the judge of what the device of this protocol has seen and what it holds."""
    return Witness(noun="the device", describe=protocols()[at.protocol].describe)


def citing(requirement: str, *findings: Iterable[Finding]) -> list[Finding]:
    """Return findings as findings about this requirement."""
    return [replace(finding, requirement=requirement) for group in findings for finding in group]


def since(reply: Reply, entries: Entries) -> Entries:
    """Return the entries that were made after the request of a call."""
    return [entry for entry in entries if entry["t_ns"] >= reply.exchange.sent_ns]


_LOOKS, _LOOK_S = 20, 0.05
"""How often, and after how many seconds each, the device is looked at for what a library sends after a call."""


async def answers_again(run: Repetition, at: Rig, *, requirement: str = "REC-001", by: Asked | None = None) -> Reply:
    """Read until that succeeds, at most for as long as the subject declares: the faults of the device are over. An adapter that does not
    claim to connect again by itself gets a session of its own first. Return the last reply.

    Args:
        by: the read; None is that of the exercise.
    """
    if not (at.subject.claims("recovery") and at.subject.reconnects):
        await at.fresh_session()
    asked = by or exercise(at).read(run.rng)
    for poke in asked.pokes:
        await at.device.poke(**poke)
    replies = await at.call_until_success(
        asked.operation, window_s=at.subject.recovery_s, from_first_call=True, **asked.inputs
    )
    run.succeeds(replies[-1], requirement=requirement, **asked.outputs)
    known = protocols()[at.protocol].exercise
    # A read brings what the device has said; a subscription, and a call that waits for messages, may bring nothing.
    if replies[-1].success and known is not None and known.waiting is not None:
        await _over_a_connection_that_lives(run, at, replies[-1], requirement)
    if known is not None and exercise(at).writing in [one.operation for one in known.otherwise]:
        # A Sparkplug host may command what it has heard of, and the proof has the nodes born again.
        at.doubt()
    return replies[-1]


async def _over_a_connection_that_lives(run: Repetition, at: Rig, reply: Reply, requirement: str) -> None:
    """Expect of a call, which may have waited in vain or for nothing at all, that the device has answered what it sent."""
    seen: Entries = reply.during(await at.journal())
    waits = 0 if at.subject.blocks(reply.operation) else _LOOKS
    while not _answered(seen) and waits and not _lost(seen):
        # A library may send after the call has been answered what it was handed during it.
        await at.pause(_LOOK_S)
        seen, waits = since(reply, await at.journal()), waits - 1
    if _answered(seen) or (at.subject.blocks(reply.operation) and not _lost(seen)):
        return
    what = "its end of the connection has vanished" if _lost(seen) else "nothing has reached it"
    message = f"{reply.label}: it claims success, and the device answered nothing: {what}"
    run.judge(reply, [Finding(code="no_exchange", message=message, requirement=requirement)])


def _answered(entries: Entries) -> bool:
    return any(entry["answers"] is not None for entry in entries)


def _lost(entries: Entries) -> bool:
    return any(entry["kind"] == "lost" for entry in entries)


async def read(run: Repetition, at: Rig) -> tuple[Asked, Reply]:
    """Set a random value at the device and read it; nothing is judged yet."""
    asked = exercise(at).read(run.rng)
    for poke in asked.pokes:
        await at.device.poke(**poke)
    return asked, await at.call(asked.operation, **asked.inputs)


async def write(run: Repetition, at: Rig) -> tuple[Asked, Reply]:
    """Write a random value; nothing is judged yet."""
    asked = exercise(at).write(run.rng)
    return asked, await at.call(asked.operation, **asked.inputs)


def answered(at: Rig, entries: Entries, *, requirement: str) -> list[Finding]:
    """Expect that the device has answered a request among entries."""
    seen = {entry["answers"] for entry in entries}
    if any(entry["seq"] in seen for entry in requests(entries)):
        return []
    return [
        Finding(
            code="no_exchange",
            message=f"{at.protocol}: the device should have answered a request during the call, it did not",
            requirement=requirement,
        )
    ]


def letters(run: Repetition) -> str:
    """Return letters that are no word."""
    return "".join(run.rng.choices("bcdfghjklmnpqrstvwxz", k=6))


async def a_read_works(run: Repetition, at: Rig, *, requirement: str | None = None) -> None:
    """Read a random value, as the positive control beside what must be refused."""
    asked, reply = await read(run, at)
    run.succeeds(reply, requirement=requirement, **asked.outputs)


async def a_write_works(run: Repetition, at: Rig, *, requirement: str | None = None) -> None:
    """Write a random value, as the positive control beside what must be refused: said, and done once."""
    asked, reply = await write(run, at)
    run.succeeds(reply, requirement=requirement, **asked.outputs)
    entries = await asked_of_the_device(at, asked, reply)
    run.witnessed(written_once(at, asked, reply, entries, requirement=requirement))


def written_once(
    at: Rig, asked: Asked, reply: Reply, entries: Entries, *, requirement: str | None = None
) -> list[Finding]:
    """Expect that what a write asked for reached the device once, and that the device had seen it when the call was a success.

    Args:
        entries: see :func:`asked_of_the_device`.
        requirement: id of the requirement that another number of them breaks; None is WR-001 for none, WR-003 for several.
    """
    found = exercise(at).done(entries, asked)
    count, seen = len(found), protocols()[at.protocol].seen(entries)
    if not (count or reply.success):
        return []
    if count == 1:
        received_ns = reply.exchange.received_ns
        late = reply.success and received_ns is not None and found[0]["t_ns"] > received_ns
        broken = exercise(at).too_late(found[0]) if late else None
        if broken is None:
            return []
        message = f"{reply.label}: it claims success, and the device saw the request only after that"
        return [Finding(code="told_too_early", message=message, requirement=broken, evidence=seen)]
    return [
        Finding(
            code="not_written_once",
            message=f"{at.protocol}: the device should have seen the write of {dict(asked.inputs)} once, it saw it {count} times"
            + said_of_repetitions(at, entries, found),
            requirement=requirement or ("WR-003" if count else "WR-001"),
            evidence=seen,
        )
    ]


def said_of_repetitions(at: Rig, entries: Entries, found: Entries) -> str:
    """Return the end of a sentence about a request that came several times: what the protocol's own rules say of that."""
    told = protocols()[at.protocol].again(entries, found) if len(found) > 1 else ""
    return f" ({told})" if told else ""


def nothing_arrived(at: Rig, entries: Entries, *, requirement: str) -> list[Finding]:
    """Expect that nothing among entries commands the plant."""
    return [
        replace(finding, requirement=requirement)
        for finding in nothing_commanded(at.protocol, entries, at.subject.declared)
    ]


async def refused_before_the_wire(
    run: Repetition, at: Rig, reply: Reply, *codes: str, requirement: str, watch: bool = False
) -> None:
    """Expect that a call that writes is refused with one of these codes, and that nothing of it reaches the device.

    Args:
        requirement: id of the requirement that anything else breaks.
        watch: the device is watched for a while for what comes after the refusal.
    """
    run.fails(reply, *codes, outcome=NOTHING_SENT, requirement=requirement)
    if watch:
        await at.watch(QUIET_S)
    since = reply.exchange.sent_ns
    entries = [entry for entry in await at.journal() if entry["t_ns"] >= since]
    run.witnessed(nothing_arrived(at, entries, requirement=requirement))


def exact_or_refused(run: Repetition, reply: Reply, *codes: str, requirement: str, **outputs: object) -> bool:
    """Expect these outputs, or a refusal with one of these codes, if there are any, and return whether it was success; for what an adapter
    need not offer."""
    if reply.success or not codes:
        return run.succeeds(reply, requirement=requirement, **outputs)
    run.fails(reply, *codes, requirement=requirement, code_requirement="ERR-002")
    return False


async def knows_node(run: Repetition, opcua: Rig, node: str) -> bool:
    """Return whether the adapter reads a node that the kit has added; one with a list of its own nodes may not know it."""
    reply = await opcua.call("read", node=node)
    if reply.success or reply.error_code not in ("illegal_address", "invalid_input", "access_denied"):
        return True
    run.fails(reply, "illegal_address", "invalid_input", "access_denied", outcome=NOTHING_SENT)
    return False


def most_characters(at: Rig, asked: Asked, name: str) -> float:
    """Return how many characters an input of a call may have by the schema of the tool that is called."""
    argument = (at.arguments_of(asked.operation, **asked.inputs) or {}).get(name)
    tool = at.tool_of(asked.operation, **asked.inputs)
    listing = None if tool is None else at.listing(asked.operation, tool)
    schema = None if listing is None else listing.get("inputSchema")
    properties = schema.get("properties") if isinstance(schema, Mapping) else None
    stated = properties.get(argument) if isinstance(properties, Mapping) else None
    if not isinstance(stated, Mapping):
        return math.inf
    others = stated.get("anyOf")
    forms = [stated, *(others if isinstance(others, list) else ())]
    most = [form.get("maxLength") for form in forms if isinstance(form, Mapping)]
    return min((one for one in most if isinstance(one, int)), default=math.inf)


async def polls(at: Rig, seen: Sequence[JournalEntry]) -> bool:
    """Tell whether the adapter makes these equal requests also when nobody asks: then they are none of a call's own."""
    before = len(await at.journal())
    await at.watch(_POLLED_S)
    describe = protocols()[at.protocol].describe
    return any(entry["request"] and describe(entry) == describe(seen[0]) for entry in (await at.journal())[before:])


async def works_again(run: Repetition, at: Rig, operation: str, **inputs: Any) -> None:
    """Expect that a call works after the device has done something wrong; an adapter that has to be connected gets a new session."""
    if not (at.subject.claims("recovery") and at.subject.reconnects):
        await at.fresh_session()
    replies = await at.call_until_success(operation, window_s=0.0, **inputs)
    run.succeeds(replies[-1], requirement="REC-001")
