"""The tasks on EtherNet/IP.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
controller. Values are different in every repetition, so that no cached or mixed-up answer can pass.
"""

from __future__ import annotations

from datetime import UTC, datetime
from functools import partial
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.ethernetip import oracle
from pytest_otmcp.protocols.journal import Image
from pytest_otmcp.protocols.session_oracle import StateChanges
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Tasks

from .common import (
    NOTHING_SENT,
    QUIET_S,
    RAPID_CALLS,
    Witness,
    a_delay_shows,
    a_failed_write_is_not_made_up_for,
    a_meaningless_switch_enables_nothing,
    allowed_first,
    drawn,
    ends_when_its_stdin_closes,
    fresh,
    outage,
    start_without_device,
    status_is_known,
    survive_a_restart,
    untold,
)

__all__ = ["TASKS"]

TASKS = Tasks()

VALVE, TARGET, FLAGS, LOCKED = "ValvePosition", "BatchTarget", "Flags", "Locked"
COUNTS, LEVELS = "Counts", "Levels"
INT_RANGE, DINT_RANGE = range(-0x8000, 0x8000), range(-(2**31), 2**31)
LARGEST_DINT = 2**31 - 1
MANY_CALLS = 30
PRIVILEGE_VIOLATION = 0x0F
PATH_SEGMENT_ERROR, PATH_DESTINATION_UNKNOWN = 0x04, 0x05


def values_of(image: Image, *tags: str) -> Witness:
    """Return the check that the controller was asked for these values."""
    return partial(oracle.read_from_device, image=image, tags=tags)


def elements(array: str, count: int) -> list[str]:
    """Return the names of the first elements of an array."""
    return [f"{array}[{index}]" for index in range(count)]


def shows(reply: Reply, held: str) -> list[Finding]:
    """Expect that a reply tells the time that the clock was set to, or one in the same minute: a clock goes on."""
    told = reply.outputs.get("time")
    minute = held[: len("2031-01-01T00:00")]
    if isinstance(told, str) and told.startswith(minute):
        return []
    message = f"{reply.label}: the time should be {minute}, the reply says {told!r}"
    return [Finding(code="wrong_value", message=message, requirement="RD-001")]


def _valve(value: int) -> dict[str, Any]:
    """Return the inputs of a write of the valve."""
    return {"tag": VALVE, "value": value, "type": "DINT"}


@TASKS.task(
    "E1",
    "normal",
    "Ping the adapter and confirm that the controller answers.",
    needs="ethernetip.ping",
    capability="reading",
    requirements="REC-002 MCP-008",
)
async def ping(run: Repetition, ethernetip: Rig) -> None:
    """Ask whether the controller can be reached.

    Said: success, and that it can be reached.
    Seen: the controller answers at least one request during the call.
    Why: a status from memory still says so when the plant is gone.
    """
    reply = await ethernetip.call("ping")
    run.succeeds(reply, reachable=True)
    await status_is_known(run, ethernetip, oracle.some_exchange, reply)


@ping.after
async def a_slow_controller_is_reported_as_slow(run: Repetition, ethernetip: Rig) -> None:
    """Ping while the controller answers a tenth of a second late.

    Said: success, and a latency that is no shorter than that.
    """
    await a_delay_shows(run, ethernetip, "ping")


@TASKS.task(
    "E2",
    "normal",
    "Read two tags and three elements of an array.",
    needs="ethernetip.read_tag ethernetip.read_array",
    capability="reading",
    requirements="RD-001 RD-002 RD-004 MCP-009",
)
async def read_sensors(run: Repetition, ethernetip: Rig) -> None:
    """Read motor speed, temperature and three levels, which were set at random just before.

    Said: these values.
    Seen: reads that cover these tags, and nothing that changes the controller.
    Why: values from memory, of another element or in another byte order look right until somebody acts on them.
    """
    # Halves below 2 to the 20 are exact as REAL.
    speed, temperature, *levels = (run.rng.randrange(-(2**20), 2**20) + 0.5 for _ in range(5))
    held = {"MotorSpeed": speed, "Temperature": temperature, **dict(zip(elements(LEVELS, 3), levels, strict=True))}
    for tag, value in held.items():
        await ethernetip.device.poke(tag=tag, value=value)
    image = await ethernetip.device.image()
    read_speed = await ethernetip.call("read_tag", tag="MotorSpeed")
    read_temperature = await ethernetip.call("read_tag", tag="Temperature")
    read_levels = await ethernetip.call("read_array", tag=f"{LEVELS}[0]", count=3)
    run.succeeds(read_speed, value=speed)
    run.succeeds(read_temperature, value=temperature)
    run.succeeds(read_levels, values=levels)
    journal = await ethernetip.journal()
    run.witnessed(
        fresh(
            journal,
            (read_speed, values_of(image, "MotorSpeed")),
            (read_temperature, values_of(image, "Temperature")),
            (read_levels, values_of(image, *elements(LEVELS, 3))),
        ),
        oracle.no_state_changing_request(journal, requirement="MCP-008"),
        oracle.holds(await ethernetip.device.image(), held),
    )


@read_sensors.after
async def the_process_ends_with_its_stdin(run: Repetition, ethernetip: Rig) -> None:
    """End the session.

    Seen: the process ends by itself.
    """
    await ends_when_its_stdin_closes(ethernetip)


@TASKS.task(
    "E3",
    "normal",
    "Write a DINT and read it back for verification.",
    needs="ethernetip.write_tag ethernetip.read_tag",
    capability="writing",
    requirements="WR-001 WR-002 WR-003",
)
async def write_and_read_back(run: Repetition, ethernetip: Rig) -> None:
    """Write a DINT, and read it.

    Said: the value that was written, in both answers.
    Seen: one write of one element of the type DINT, the least significant byte first; every other value stays as it was.
    Why: an adapter that says "written" may have written twice, beside the tag, as another type, or not at all.
    """
    value = 40 + run.rep
    await ethernetip.device.poke(tag=VALVE, value=~value)
    before = await ethernetip.device.image()
    wrote = await ethernetip.call("write_tag", tag=VALVE, value=value, type="DINT")
    after = await ethernetip.device.image()
    read = await ethernetip.call("read_tag", tag=VALVE)
    run.succeeds(wrote, value=value)
    # What the controller holds now may not be the value, which is the fault of the write; the read has to tell it.
    run.succeeds(read, value=oracle.held(after, VALVE))
    journal = await ethernetip.journal()
    run.witnessed(
        oracle.exactly_one_write(journal, after, VALVE, "DINT", value),
        fresh(journal, (read, values_of(after, VALVE))),
        oracle.only_changed(before, after, {VALVE: value}),
    )


@TASKS.task(
    "E4",
    "normal",
    "Attempt a write with writes disabled and expect a guarded rejection.",
    needs="ethernetip.write_tag ethernetip.read_tag ethernetip.guard",
    capability="write_protection",
    requirements="WR-004 WR-005 ERR-006",
)
async def guarded_write(run: Repetition, ethernetip_ro: Rig) -> None:
    """Write a value through the adapter that was started with writes disabled.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`.
    Seen: no service that writes, sets, starts, stops or resets anything; the controller holds what it held.
    Why: the write switch is what keeps an assistant's mistake out of the plant.
    """
    before = await ethernetip_ro.device.image()
    reply = await ethernetip_ro.call("write_tag", tag=VALVE, value=999, type="DINT")
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.witnessed(
        oracle.no_state_changing_request(await ethernetip_ro.journal()),
        oracle.only_changed(before, await ethernetip_ro.device.image(), {}, otherwise="WR-004"),
    )


@guarded_write.after
async def the_guard_was_put_to_the_test(run: Repetition, ethernetip: Rig, ethernetip_ro: Rig) -> None:
    """Read with writes disabled, and write the same value with writes enabled: both must work, or the refusal proves
    nothing. Then write through the adapter that was started with a write switch that means nothing.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`, unless the adapter refuses to start so.
    Seen: over the whole life of the read-only sessions, their end included, nothing that changes the controller.
    """
    run.succeeds(await ethernetip_ro.call("read_tag", tag=VALVE))
    written = await ethernetip.call("write_tag", tag=VALVE, value=999, type="DINT")
    run.succeeds(written, value=999)
    run.witnessed(
        oracle.some_exchange(await ethernetip_ro.journal()),
        oracle.exactly_one_write(await ethernetip.journal(), await ethernetip.device.image(), VALVE, "DINT", 999),
    )
    # This controller's journal holds the whole life of the read-only session, its closing included, and nothing else.
    await ethernetip_ro.close_session()
    run.witnessed(oracle.nothing_changed_by(await ethernetip_ro.follow(StateChanges)))
    await a_meaningless_switch_enables_nothing(run, ethernetip_ro, "write_tag", tag=VALVE, value=999, type="DINT")


@TASKS.task(
    "E5",
    "normal",
    "Write one bit of a DINT while its neighbour changes.",
    needs="ethernetip.write_tag",
    capability="writing",
    requirements="WR-011 WR-002",
)
async def write_one_bit(run: Repetition, ethernetip: Rig) -> None:
    """Set the bit 3 of a DINT, while its bit 6 turns before every request.

    Said: success.
    Seen: one Read Modify Write Tag, whose masks are about this bit alone; every other bit is as the plant left it.
    Why: who reads a word, changes a bit and writes the word takes back what the program has done meanwhile.
    """
    start = run.rng.randrange(0x100) & ~0x08
    await ethernetip.device.poke(tag=FLAGS, value=start)
    await ethernetip.device.poke(restless=[{"tag": FLAGS, "bits": 0x40}])
    before = await ethernetip.device.image()
    reply = await ethernetip.call("write_tag", tag=f"{FLAGS}.3", value=True, type="BOOL")
    after = await ethernetip.device.image()
    await ethernetip.device.poke(restless=[])
    run.succeeds(reply, value=True)
    turned = 0x40 if oracle.changes_of_restless_bits(after) % 2 else 0
    run.witnessed(
        oracle.exactly_one_bit_write(await ethernetip.journal(), after, FLAGS, 3, True),
        oracle.only_changed(before, after, {FLAGS: start ^ turned | 0x08}),
    )


@TASKS.task(
    "E6",
    "normal",
    "Make thirty calls and count the CIP connections that are open.",
    needs="ethernetip.read_tag",
    capability="load",
    requirements="RES-001",
)
async def connections_do_not_grow(run: Repetition, ethernetip: Rig) -> None:
    """Read a tag, then read it thirty times more.

    Said: the tag's value, every time.
    Seen: no more CIP connections than after the first call.
    Why: a controller has few connections, and those that are forgotten lock everybody else out.
    """
    value = run.rng.choice(DINT_RANGE)
    await ethernetip.device.poke(tag=TARGET, value=value)
    run.succeeds(await ethernetip.call("read_tag", tag=TARGET), value=value)
    before: Image = await ethernetip.device.image()
    for _ in range(MANY_CALLS):
        run.succeeds(await ethernetip.call("read_tag", tag=TARGET), value=value)
    run.witnessed(oracle.connections_left(await ethernetip.device.image(), most=before["connections"]))


@connections_do_not_grow.after
async def connections_are_closed_at_the_end(run: Repetition, ethernetip: Rig) -> None:
    """End the session, and begin another one.

    Seen: the CIP connection of the session that has ended is closed by a Forward Close, not left to be forgotten.
    """
    before: Image = await ethernetip.device.image()
    await ethernetip.fresh_session()
    run.witnessed(oracle.connections_forgotten(await ethernetip.device.image(), most=before["forgotten"]))


@TASKS.task(
    "E7",
    "normal",
    "Set the controller's clock and read it.",
    needs="ethernetip.set_clock ethernetip.read_clock",
    capability="writing",
    requirements="WR-001 WR-003 RD-001",
)
async def set_and_read_the_clock(run: Repetition, ethernetip: Rig) -> None:
    """Set the clock to a time of 2031, and read it.

    Said: that time, in both answers.
    Seen: one request that sets the clock, to that time; the controller answers a request during the second call.
    Why: an adapter that sets the time of its own machine sets another one than was asked for, and recipes run by the clock.
    """
    moment = datetime(2031, 1 + run.rep % 12, run.rng.randrange(1, 28), run.rng.randrange(24), 30, tzinfo=UTC)
    wrote = await ethernetip.call("set_clock", time=moment.isoformat())
    after = await ethernetip.device.image()
    read = await ethernetip.call("read_clock")
    run.succeeds(wrote)
    # What the controller's clock shows now may not be that time, which is the fault of the write; the read has to tell it.
    held = oracle.held(after, "Clock")
    if run.succeeds(read) and isinstance(held, str):
        run.judge(read, shows(read, held))
    journal = await ethernetip.journal()
    run.witnessed(
        oracle.one_clock_setting(wrote.during(journal)),
        oracle.holds(after, {"Clock": moment.isoformat()}),
        fresh(journal, (read, oracle.some_exchange)),
    )


@TASKS.task(
    "FE1",
    "fault",
    "Read a tag that does not exist and expect a structured protocol error.",
    needs="ethernetip.read_tag",
    capability="refusing",
    requirements="ERR-002 ENV-007 RD-005 RD-007",
    keys="ethernetip.probes.missing_tag",
)
async def read_missing_tag(run: Repetition, ethernetip: Rig) -> None:
    """Read a tag that the controller does not have.

    Said: a failure with `illegal_address`. An adapter that refuses by a list of tags may also say `invalid_input`; nothing was sent then.
    Seen: the read, which the controller refuses with the general status 04 or 05.
    Why: an assistant that gets a zero for a tag that does not exist believes the zero.
    """
    missing = str(ethernetip.subject.probe("missing_tag"))
    reply = await ethernetip.call("read_tag", tag=missing)
    seen = reply.during(await ethernetip.journal())
    if not oracle.reached(seen, await ethernetip.device.image(), [missing]):
        run.fails(reply, "illegal_address", "invalid_input", outcome=NOTHING_SENT, requirement="ERR-002")
        return
    run.fails(reply, "illegal_address", requirement="ERR-002")
    unknown = oracle.refused_with(seen, PATH_DESTINATION_UNKNOWN)
    run.witnessed(unknown and oracle.refused_with(seen, PATH_SEGMENT_ERROR))


@read_missing_tag.after
async def what_is_there_can_be_read_and_nothing_follows_the_end(run: Repetition, ethernetip: Rig) -> None:
    """Read a tag that is there: a refusal proves something only if the same call works elsewhere. Then read two elements of which
    one lies behind the end of the array.

    Said: success and the value; then a failure with `illegal_address`, `invalid_input` or `limit_exceeded`.
    """
    value = run.rng.choice(DINT_RANGE)
    await ethernetip.device.poke(tag=TARGET, value=value)
    run.succeeds(await ethernetip.call("read_tag", tag=TARGET), value=value)
    beyond = await ethernetip.call("read_array", tag=f"{LEVELS}[9]", count=2)
    run.fails(
        beyond, "illegal_address", "invalid_input", "limit_exceeded", requirement="RD-007", code_requirement="ERR-002"
    )


@TASKS.task(
    "FE2",
    "fault",
    "Write an overflow value (2 to the 40) to a DINT and expect adapter rejection.",
    needs="ethernetip.write_tag",
    capability="refusing",
    requirements="ADR-003 ADR-004 ERR-006",
)
async def write_overflow(run: Repetition, ethernetip: Rig) -> None:
    """Write 2 to the 40 to a DINT.

    Said: a failure with `range_overflow` and the outcome `not_sent`.
    Seen: no request that changes the controller; it holds what it held.
    Why: 2 to the 40 cut down to 32 bits is 0, a value that nobody asked for.
    """
    before = await ethernetip.device.image()
    reply = await ethernetip.call("write_tag", tag=VALVE, value=2**40, type="DINT")
    run.fails(reply, "range_overflow", outcome="not_sent", requirement="ADR-003")
    run.witnessed(
        oracle.no_state_changing_request(await ethernetip.journal(), requirement=untold(reply, "ADR-003")),
        oracle.only_changed(before, await ethernetip.device.image(), {}, otherwise=untold(reply, "ADR-003")),
    )


@write_overflow.after
async def the_largest_value_is_accepted(run: Repetition, ethernetip: Rig) -> None:
    """Write 2147483647, which fits, or what the tool's own schema allows.

    Said: success.
    Seen: one write, and the value in the tag.
    """
    await ethernetip.stays_quiet(QUIET_S, partial(oracle.no_state_changing_request, requirement="ADR-003"))
    fits = allowed_first(ethernetip, "write_tag", (LARGEST_DINT, 100, 1), _valve)
    reply = await ethernetip.call("write_tag", **_valve(fits))
    run.succeeds(reply, value=fits)
    image = await ethernetip.device.image()
    run.witnessed(
        oracle.exactly_one_write(await ethernetip.journal(), image, VALVE, "DINT", fits),
        oracle.holds(image, {VALVE: fits}),
    )


@TASKS.task(
    "FE3",
    "fault",
    "Write a text to a DINT and expect adapter rejection.",
    needs="ethernetip.write_tag",
    capability="refusing",
    requirements="ADR-004 ERR-006",
)
async def write_wrong_type(run: Repetition, ethernetip: Rig) -> None:
    """Write "abc" to a DINT.

    Said: a failure with `type_mismatch` or `invalid_input`, and the outcome `not_sent`.
    Seen: no request that changes the controller; it holds what it held.
    Why: whatever four bytes a text becomes, they are a number that nobody asked for.
    """
    before = await ethernetip.device.image()
    reply = await ethernetip.call("write_tag", tag=VALVE, value="abc", type="DINT")
    run.fails(reply, "type_mismatch", "invalid_input", outcome="not_sent", requirement="ADR-004")
    run.witnessed(
        oracle.no_state_changing_request(await ethernetip.journal(), requirement=untold(reply, "ADR-004")),
        oracle.only_changed(before, await ethernetip.device.image(), {}, otherwise=untold(reply, "ADR-004")),
    )


@TASKS.task(
    "FE4",
    "fault",
    "Write two tags in one call, of which one cannot be written, and expect a partial failure.",
    needs="ethernetip.write_tags",
    capability="refusing",
    requirements="ERR-008 WR-001 WR-002",
)
async def write_two_tags_of_which_one_is_locked(run: Repetition, ethernetip: Rig) -> None:
    """Write a tag, and in the same call one that clients may read only.

    Said: a failure with `partial_failure` and the outcome `partial`.
    Seen: the first tag holds its new value, the second one its old; nothing else has changed.
    Why: the answer to a packet of services is a success where one of them was refused: its statuses have to be looked at.
    """
    value = 40 + run.rep
    await ethernetip.device.poke(tag=VALVE, value=~value)
    before = await ethernetip.device.image()
    items = [{"tag_name": VALVE, "value": value}, {"tag_name": LOCKED, "value": value}]
    reply = await ethernetip.call("write_tags", items=items)
    run.fails(reply, "partial_failure", outcome="partial", requirement="ERR-008")
    run.witnessed(
        oracle.refused_with(reply.during(await ethernetip.journal()), PRIVILEGE_VIOLATION),
        oracle.only_changed(before, await ethernetip.device.image(), {VALVE: value}),
    )


@TASKS.task(
    "FE5",
    "fault",
    "Write a tag that clients may only read and expect a structured protocol error.",
    needs="ethernetip.write_tag",
    capability="refusing",
    requirements="ERR-002 WR-001",
)
async def write_what_is_locked(run: Repetition, ethernetip: Rig) -> None:
    """Write a tag whose external access is "read only".

    Said: a failure with `access_denied` or `not_writable`.
    Seen: the controller refuses with the general status 0F, unless nothing was sent; it holds what it held.
    Why: who takes any answer for a confirmation reports a write that the controller has refused.
    """
    before = await ethernetip.device.image()
    reply = await ethernetip.call("write_tag", tag=LOCKED, value=40 + run.rep, type="DINT")
    run.fails(reply, "access_denied", "not_writable", requirement="WR-001", code_requirement="ERR-002")
    seen = reply.during(await ethernetip.journal())
    if oracle.changes_asked_for(seen):
        run.witnessed(oracle.refused_with(seen, PRIVILEGE_VIOLATION))
    run.witnessed(oracle.only_changed(before, await ethernetip.device.image(), {}))


@TASKS.task(
    "SE1",
    "stress",
    "Four concurrent reads of tags.",
    needs="ethernetip.read_tag",
    capability="load",
    requirements="CON-001",
)
async def concurrent_reads(run: Repetition, ethernetip: Rig) -> None:
    """Read four elements of an array by four calls at the same time.

    Said: in each answer the value of its own element.
    Seen: for each call a read that covers its element, during the call.
    Why: an answer that belongs to another call is a wrong value that looks right.
    """
    values = dict(zip(elements(COUNTS, 4), run.rng.sample(INT_RANGE, 4), strict=True))
    for tag, value in values.items():
        await ethernetip.device.poke(tag=tag, value=value)
    image = await ethernetip.device.image()
    replies = await run.together(*(ethernetip.call("read_tag", tag=tag) for tag in values))
    for reply, value in zip(replies, values.values(), strict=True):
        run.succeeds(reply, value=value)
    asked = [(reply, values_of(image, tag)) for reply, tag in zip(replies, values, strict=True)]
    run.witnessed(fresh(await ethernetip.journal(), *asked))


@TASKS.task(
    "SE2",
    "stress",
    "Concurrent read and write of a tag.",
    needs="ethernetip.read_tag ethernetip.write_tag",
    capability="load",
    requirements="CON-004 WR-003",
)
async def concurrent_read_and_write(run: Repetition, ethernetip: Rig) -> None:
    """Read a DINT and write it at the same time.

    Said: the old value or the new one for the read, success for the write.
    Seen: one write; the tag holds the new value.
    Why: a mixture of two values, or a lost write, shows only under load.
    """
    old, new = drawn(
        ethernetip,
        "write_tag",
        lambda: run.rng.sample(DINT_RANGE, 2),
        lambda pair: {"tag": TARGET, "value": pair[1], "type": "DINT"},
    )
    await ethernetip.device.poke(tag=TARGET, value=old)
    read, written = await run.together(
        ethernetip.call("read_tag", tag=TARGET),
        ethernetip.call("write_tag", tag=TARGET, value=new, type="DINT"),
    )
    run.succeeds(read)
    run.one_of(read, "value", old, new)
    run.succeeds(written, value=new)
    image = await ethernetip.device.image()
    run.witnessed(
        oracle.exactly_one_write(await ethernetip.journal(), image, TARGET, "DINT", new),
        oracle.holds(image, {TARGET: new}),
    )


@TASKS.task(
    "SE3",
    "stress",
    "Fifty reads of tags in a row.",
    needs="ethernetip.read_tag",
    capability="load",
    requirements="CON-006",
)
async def rapid_reads(run: Repetition, ethernetip: Rig) -> None:
    """Read fifty elements of an array, one call after the other.

    Said: the right value in every answer.
    Seen: for each call a read that covers its element, during the call.
    Why: leaks, caches and connections that are used up show in a long series only.
    """
    values = dict(zip(elements(COUNTS, RAPID_CALLS), run.rng.sample(INT_RANGE, RAPID_CALLS), strict=True))
    for tag, value in values.items():
        await ethernetip.device.poke(tag=tag, value=value)
    image = await ethernetip.device.image()
    asked = []
    for tag, value in values.items():
        reply = await ethernetip.call("read_tag", tag=tag)
        run.succeeds(reply, value=value)
        asked.append((reply, values_of(image, tag)))
    run.witnessed(fresh(await ethernetip.journal(), *asked))


@TASKS.task(
    "SE4",
    "stress",
    "Endpoint restart between reads of an array.",
    needs="ethernetip.any_read ethernetip.recovery",
    capability="outages",
    requirements="REC-001 REC-002 RD-004",
    keys="ethernetip.recovery",
)
async def restart(run: Repetition, ethernetip: Rig) -> None:
    """Read four elements; again after the controller was stopped; and again after it was started.

    Said: success; then a failure with `connect_failed`, `connection_lost` or `timeout`; then success in the same
        session.
    Seen: a read after the controller is back.
    Why: an outage of the line must not need a person who restarts the adapter, and old values must not hide it.
    """
    await survive_a_restart(run, ethernetip)


@restart.after
async def a_failed_write_is_not_delivered_later(run: Repetition, ethernetip: Rig) -> None:
    """Write while the controller is away, and read when it is back.

    Said: a failure for the write, success for the read.
    Seen: no write: what was reported as failed is not made up for.
    """
    await a_failed_write_is_not_made_up_for(run, ethernetip)


@TASKS.task(
    "R-ethernetip",
    "recovery",
    "Recover from a restart of the Logix controller.",
    needs="ethernetip.any_read",
    capability="outages",
    requirements="REC-001 REC-002 MCP-009",
    keys="ethernetip.recovery",
)
async def recovery(run: Repetition, ethernetip: Rig) -> None:
    """Read; again after the controller was stopped; then, after it was started, in the same session and in a fresh one with
    a new process.

    Said: success; a failure of the connection; success in both sessions.
    Seen: the reads of both sessions, and nothing that changes the plant.
    Why: how soon an outage is noticed, and how soon work goes on, decides what the adapter can be used for.
    """
    await outage(run, ethernetip)


@recovery.after
async def the_adapter_starts_without_its_controller(run: Repetition, ethernetip: Rig) -> None:
    """Start the adapter while its controller is down, ask, and ask again when it is there.

    Said: a failure of the connection first, success then.
    """
    await start_without_device(run, ethernetip)
