"""The items of a real device: what can be judged where no value can be set, and nothing is written or cut off but with consent.

Three witnesses are asked: the adapter's reply, the tap that all of its requests pass, or a capture beside it, and a second client straight at the device. What the
device does by itself is nobody's fault: values may move, so that only what both looks at the device agree on is demanded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

from pytest_otmcp.core.matrix import FIELD
from pytest_otmcp.core.strict_json import same_json
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.field import Field, agrees
from pytest_otmcp.protocols.journal import Image
from pytest_otmcp.protocols.oracle import Witness, state_changing
from pytest_otmcp.protocols.protocol import GUARD
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial.check import Generic, on_protocol
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Tasks

from .tasks.common import CONNECTION_FAULTS, fresh
from .tasks.common import Witness as SeenByTap

__all__ = ["TASKS"]

TASKS = Tasks()

_NOT_THERE = ("illegal_address", "invalid_input", "limit_exceeded")
_HOLDS = Witness(noun="the device", describe=lambda entry: entry["kind"]).holds
"""Expects of the second client that points have these values."""


def _item(
    number: int, title: str, *, capability: str, requirements: str, guard: bool = False, recovers: bool = False
) -> Callable[[Generic], Generic]:
    """Return a decorator that turns steps into an item of each protocol with real devices."""

    def declare(steps: Generic) -> Generic:
        for key, protocol in protocols().items():
            if protocol.real is not None:
                launches = [GUARD] * guard
                needs = " ".join(f"{key}.{facet}" for facet in [*launches, *["recovery"] * recovers]) or key
                declared = TASKS.task(
                    f"F{number}-{key}", FIELD, title, needs=needs, capability=capability, requirements=requirements
                )
                declared(on_protocol(key, steps, launches))
        return steps

    return declare


def _field(at: Rig) -> Field:
    field = protocols()[at.protocol].real
    assert field is not None
    return field


async def _image(at: Rig) -> Image:
    return cast(Image, await at.device.image())


async def _call(at: Rig, asked: Asked, *due: str) -> Reply:
    """Call; a failure without one of these codes is judged where it can only be the adapter's own."""
    reply = await at.call(asked.operation, **asked.inputs)
    if not reply.success and reply.error_code not in due:
        await at.device.excuse()
    return reply


@_item(
    1,
    "Read values that differ from a real device.",
    capability="reading",
    requirements="RD-001 RD-002 RD-004 MCP-008",
)
async def read_what_is_there(run: Repetition, at: Rig) -> None:
    """Read values that differ, one by one and several at once, by each operation that reads; then the first one again.

    Said: what the second client reads before and after; where it reads two values, one of them or what was on the wire meanwhile.
    Seen: on the wire a read of what was asked for, during the call, and nothing that changes the plant.
    Why: a value from memory, from a neighbour or from another device looks right until somebody acts on it.
    """
    field, before = _field(at), await _image(at)
    reads = list(field.reads(before, at.subject.claims))
    if not reads:
        run.not_applicable("the adapter claims no operation that reads what the device has")
    # What was kept in memory shows when it is asked for again.
    reads.append(reads[0])
    replies = [await _call(at, one) for one in reads]
    after, journal = await _image(at), await at.journal()
    for one, reply in zip(reads, replies, strict=True):
        if all(same_json(after["points"][point], value) for point, value in one.points.items()):
            run.succeeds(reply, requirement=None, **_disagreeing(one, reply))
        elif run.succeeds(reply):
            _is_of_its_time(run, reply, one, [after["points"][point] for point in one.points], field.sent(journal))
    asked = [(reply, _was_read(field, one)) for one, reply in zip(reads, replies, strict=True)]
    run.witnessed(
        fresh(journal, *asked),
        protocols()[at.protocol].unsolicited(journal, at.subject.declared),
    )


def _was_read(field: Field, asked: Asked) -> SeenByTap:
    return lambda entries: field.was_read(entries, asked)


def _disagreeing(asked: Asked, reply: Reply) -> dict[str, object]:
    return {name: value for name, value in asked.outputs.items() if not agrees(value, reply.outputs.get(name))}


def _is_of_its_time(run: Repetition, reply: Reply, asked: Asked, now: list[object], sent: Sequence[object]) -> None:
    """Expect the values from before or after, or values that followed one another on the wire."""
    passed = [list(sent[start : start + len(now)]) for start in range(len(sent) - len(now) + 1)]
    for name, told in _disagreeing(asked, reply).items():
        values = [told, now, *passed] if isinstance(told, list) else [told, *now, *sent]
        run.one_of(reply, name, *values, requirement="RD-001")


@_item(
    2,
    "Read what a real device does not have.",
    capability="reading",
    requirements="ERR-002 RD-001",
)
async def read_what_is_not_there(run: Repetition, at: Rig) -> None:
    """Read what is not there, as the device has told the second client.

    Said: a failure.
    Seen: on the wire nothing that changes the plant.
    Why: a zero for what is not there is a value as good as any to an assistant.
    """
    asked = _field(at).beyond(await _image(at), at.subject.claims)
    if asked is None:
        run.not_applicable(
            "the device tells the second client of nothing that the adapter can read that it is not there"
        )
    reply = await _call(at, asked, *_NOT_THERE)
    run.fails(reply, *_NOT_THERE, requirement="ERR-001", code_requirement="ERR-002")
    run.witnessed(protocols()[at.protocol].unsolicited(await at.journal(), at.subject.declared))


def _write(run: Repetition, at: Rig, image: Image) -> Asked:
    """Return the write of another value than the device holds to a point that may be written."""
    for point, (lowest, highest) in image["writable"].items():
        held = image["points"][point]
        for value in map(type(held), (int(lowest), int(highest), int(lowest) + 1)):
            asked = None if value == held or not lowest <= value <= highest else _field(at).write(point, value)
            if asked is not None and at.subject.claims(asked.operation):
                return asked
    run.not_applicable("the adapter claims no operation that writes another value to what the consent names")


@_item(
    3,
    "Write to a real device with writes disabled.",
    capability="write_protection",
    requirements="WR-004 WR-005 ERR-006",
    guard=True,
)
async def writes_disabled(run: Repetition, at: Rig, guarded: Rig) -> None:
    """Write a value that the consent allows through the adapter that was started with writes disabled.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`.
    Seen: at the tap no request that changes the plant. The tap would withhold it.
    Why: the write switch is what keeps an assistant's mistake out of the plant.
    """
    asked = _write(run, guarded, await _image(guarded))
    reply = await _call(guarded, asked, "writes_disabled")
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.witnessed(protocols()[at.protocol].unsolicited(await guarded.journal(), guarded.subject.declared))


@_item(
    4,
    "Write to a real device what the tap withholds.",
    capability="refusing",
    requirements="WR-001 WR-003",
)
async def a_write_that_never_arrives(run: Repetition, at: Rig) -> None:
    """Write a value that the consent allows, while the tap withholds every write.

    Said: a failure.
    Seen: at the tap one request at most; by the second client the value from before.
    Why: an adapter that says "written" of what no device has confirmed lets an assistant go on as if it were so.
    """
    await at.prove()
    before = await _image(at)
    asked = _write(run, at, before)
    reply = await _call(at, asked, *CONNECTION_FAULTS)
    run.fails(reply, *CONNECTION_FAULTS, requirement="WR-001", code_requirement="ERR-005")
    held, journal = await _image(at), await at.journal()
    # An adapter that sends nothing has refused by itself, which its answer says; it must not send twice.
    once = _field(at).was_written(journal, asked) if state_changing(journal) else []
    run.witnessed(once, _HOLDS(held, {point: before["points"][point] for point in asked.points}))


@_item(
    5,
    "Write to a real device within the consent.",
    capability="writing",
    requirements="WR-001 WR-003",
)
async def a_write_within_the_consent(run: Repetition, at: Rig) -> None:
    """Write another value than the device holds to a point of the consent. The kit gives the old value back afterwards.

    Said: success, and the value.
    Seen: at the tap one request that writes it; the second client reads it.
    Why: what an assistant believes to be set must be set, once.
    """
    await at.prove()
    asked = _write(run, at, await _image(at))
    await at.device.poke(writes=True)
    try:
        reply = await _call(at, asked)
        held = await _image(at)
    finally:
        await at.device.poke(writes=False)
    run.succeeds(reply, **asked.outputs)
    run.witnessed(_field(at).was_written(await at.journal(), asked), _HOLDS(held, asked.points))


@_item(
    6,
    "Read from a real device that is cut off, and again when it is back.",
    capability="outages",
    requirements="REC-001 REC-002 ERR-005",
    recovers=True,
)
async def cut_off_and_back(run: Repetition, at: Rig) -> None:
    """Read by each operation that reads; cut the device off by the command of the consent, read twice by each; bring it back by the other
    command, read until that succeeds, then by each.

    Said: values; failures with `connect_failed`, `connection_lost` or `timeout`; within the time that the subject declares, counted from
        when the second client reads again, the values that it reads.
    Seen: on the wire the reads after the device is back, and nothing that changes the plant.
    Why: a device whose power fails closes no connection; a value of before that looks like one of now hides it from whoever has to act.
    """
    field = _field(at)
    reads = {one.operation: one for one in reversed(field.reads(await _image(at), at.subject.claims))}
    if not reads:
        run.not_applicable("the adapter claims no operation that reads what the device has")
    for one in reads.values():
        run.succeeds(await _call(at, one))
    await at.stop_device()
    for one in [*reads.values()] * 2:
        run.fails(
            await _call(at, one, *CONNECTION_FAULTS),
            *CONNECTION_FAULTS,
            requirement="REC-002",
            code_requirement="ERR-005",
        )
    await at.start_device()
    first = next(iter(reads.values()))
    back = (await at.call_until_success(first.operation, window_s=at.subject.recovery_s, **first.inputs))[-1]
    if not back.success:
        await at.device.excuse()
    if not run.succeeds(back, requirement="REC-001"):
        return
    replies = [await _call(at, one) for one in reads.values()]
    after, journal = await _image(at), await at.journal()
    for one, reply in zip(reads.values(), replies, strict=True):
        if run.succeeds(reply, requirement="REC-001"):
            _is_of_its_time(run, reply, one, [after["points"][point] for point in one.points], field.sent(journal))
    asked = [(reply, _was_read(field, one)) for one, reply in zip(reads.values(), replies, strict=True)]
    run.witnessed(
        fresh(journal, *asked),
        protocols()[at.protocol].unsolicited(journal, at.subject.declared),
    )
