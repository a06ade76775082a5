"""The tasks on EtherNet/IP.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
controller. Values are different in every repetition, so that no cached or mixed-up answer can pass.
"""

from __future__ import annotations

from datetime import UTC, datetime

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.ethernetip import calls, oracle
from pytest_otmcp.protocols.ethernetip.points import ELEMENT, TARGET, VALVE, array, elements, tag
from pytest_otmcp.protocols.exercise import Asked, Contended
from pytest_otmcp.protocols.journal import Entries, Image
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from . import further
from .common import RAPID_CALLS, allowed_first, fresh

__all__ = ["TASKS"]

FLAGS = "Flags"
LOCKED = tag("Locked")
LEVELS = "Levels"
INT_RANGE, DINT_RANGE = range(-0x8000, 0x8000), range(-(2**31), 2**31)
LARGEST_DINT = 2**31 - 1
MANY_CALLS = 30
PRIVILEGE_VIOLATION = 0x0F
PATH_SEGMENT_ERROR, PATH_DESTINATION_UNKNOWN = 0x04, 0x05


TASKS = further.Further(
    "ethernetip", witness=oracle.WITNESS, was_read=calls.was_read, one_write=calls.one_write, resolves=True
)


def shows(reply: Reply, held: str) -> list[Finding]:
    """Expect that a reply tells the time that the clock was set to, or one in the same minute: a clock goes on."""
    told = reply.outputs.get("time")
    minute = held[: len("2031-01-01T00:00")]
    if isinstance(told, str) and told.startswith(minute):
        return []
    message = f"{reply.label}: the time should be {minute}, the reply says {told!r}"
    return [Finding(code="wrong_value", message=message, requirement="RD-001")]


further.ping(TASKS, "E1", "Ping the adapter and confirm that the controller answers.")


def sensors(run: Repetition) -> list[Asked]:
    """Return the reads of motor speed, temperature and three levels."""
    # Halves below 2 to the 20 are exact as REAL.
    speed, temperature, *levels = (run.rng.randrange(-(2**20), 2**20) + 0.5 for _ in range(5))
    return [tag("MotorSpeed").read(speed), tag("Temperature").read(temperature), array(0, 3, LEVELS).read(levels)]


further.reads(
    TASKS,
    "E2",
    "Read two tags and three elements of an array.",
    needs="read_tag read_array",
    make=sensors,
    asked="Read motor speed, temperature and three levels, which were set at random just before.",
)

further.reads_back(
    TASKS,
    "E3",
    "Write a DINT and read it back for verification.",
    needs="write_tag read_tag",
    write=lambda run: VALVE.write(40 + run.rep, before=~(40 + run.rep)),
    read=VALVE.read_again,
    seen="One write of one element of the type DINT, the least significant byte first; every other value stays as it was.",
)

further.guard(
    TASKS,
    "E4",
    "Attempt a write with writes disabled and expect a guarded rejection.",
    needs="write_tag read_tag",
    write=lambda run: VALVE.write(999),
    read=lambda run: VALVE.reads(),
    seen="No service that writes, sets, starts, stops or resets anything; {device} holds what it held.",
)


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
    asked = TARGET.read(run.rng.choice(DINT_RANGE))
    await further.set_up(ethernetip, asked)
    run.succeeds(await further.call(ethernetip, asked), **asked.outputs)
    before: Image = await ethernetip.device.image()
    for _ in range(MANY_CALLS):
        run.succeeds(await further.call(ethernetip, asked), **asked.outputs)
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


def unknown(entries: Entries) -> list[Finding]:
    """Expect that the controller refused a path, whole or in part."""
    found = oracle.refused_with(entries, PATH_DESTINATION_UNKNOWN)
    return found and oracle.refused_with(entries, PATH_SEGMENT_ERROR)


further.there(
    TASKS,
    further.missing(
        TASKS,
        "FE1",
        "Read a tag that does not exist and expect a structured protocol error.",
        needs="read_tag",
        key="missing_tag",
        make=lambda name: tag(str(name)).reads(),
        reached=calls.reached,
        refused=unknown,
        seen="The read, which {device} refuses with the general status 04 or 05.",
    ),
    read=lambda run: TARGET.read(run.rng.choice(DINT_RANGE)),
    beyond=array(9, 2, LEVELS).reads(),
)


def largest(run: Repetition, at: Rig) -> Asked:
    """Return the write of the largest DINT, or of one that the schema of the tool allows."""
    return VALVE.write(allowed_first(at, "write_tag", (LARGEST_DINT, 100, 1), lambda value: VALVE.write(value).inputs))


further.overflow(
    TASKS,
    "FE2",
    "Write an overflow value (2 to the 40) to a DINT and expect adapter rejection.",
    needs="write_tag",
    make=lambda run: VALVE.writes(2**40),
    fits=largest,
    why="2 to the 40 cut down to 32 bits is 0, a value that nobody asked for.",
)

further.refused_by_itself(
    TASKS,
    "FE3",
    "Write a text to a DINT and expect adapter rejection.",
    needs="write_tag",
    make=lambda run: VALVE.writes("abc"),
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
    asked = VALVE.write(value, before=~value)
    await further.set_up(ethernetip, asked)
    before = await ethernetip.device.image()
    items = [{"tag_name": one.inputs["tag"], "value": value} for one in (asked, LOCKED.writes(value))]
    reply = await ethernetip.call("write_tags", items=items)
    run.fails(reply, "partial_failure", outcome="partial", requirement="ERR-008")
    run.witnessed(
        oracle.refused_with(reply.during(await ethernetip.journal()), PRIVILEGE_VIOLATION),
        oracle.only_changed(before, await ethernetip.device.image(), asked.points),
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
    reply = await further.call(ethernetip, LOCKED.writes(40 + run.rep))
    run.fails(reply, "access_denied", "not_writable", requirement="WR-001", code_requirement="ERR-002")
    seen = reply.during(await ethernetip.journal())
    if oracle.changes_asked_for(seen):
        run.witnessed(oracle.refused_with(seen, PRIVILEGE_VIOLATION))
    run.witnessed(oracle.only_changed(before, await ethernetip.device.image(), {}))


def counts(run: Repetition, count: int) -> list[Asked]:
    """Return the reads of the first elements of an array."""
    values = run.rng.sample(INT_RANGE, count)
    return [tag(name, ELEMENT).read(value) for name, value in zip(elements(0, count), values, strict=True)]


further.four_at_once(TASKS, "SE1", "Four concurrent reads of tags.", needs="read_tag", make=lambda run: counts(run, 4))


def contended(run: Repetition) -> Contended:
    """Return a read and a write of a DINT."""
    return TARGET.contended(*run.rng.sample(DINT_RANGE, 2))


further.beside(TASKS, "SE2", "Concurrent read and write of a tag.", needs="read_tag write_tag", make=contended)

further.rapid(
    TASKS,
    "SE3",
    "Fifty reads of tags in a row.",
    needs="read_tag",
    make=lambda run: counts(run, RAPID_CALLS),
)

further.restart(TASKS, "SE4", "Endpoint restart between reads of an array.")

further.recovery(TASKS, "Recover from a restart of the Logix controller.")
