"""The tasks on EtherCAT.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
slaves. Values are different in every repetition, so that no cached or mixed-up answer can pass. No verdict depends on a cycle.
"""

from __future__ import annotations

from functools import partial

from pytest_otmcp.protocols.ethercat import calls, oracle
from pytest_otmcp.protocols.ethercat.points import (
    ACCELERATION,
    DRIVE,
    TERMINAL,
    TYPED,
    bytes_of,
    inputs_of,
    object_at,
    outputs_of,
)
from pytest_otmcp.protocols.exercise import Asked, Contended
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

from . import further
from .common import RAPID_CALLS, a_meaningless_switch_enables_nothing, fresh, untold

__all__ = ["TASKS"]

NO_OBJECT, READ_ONLY, TOO_HIGH, NO_OUTPUTS = 0x06020000, 0x06010002, 0x06090031, 0x001D
KEPT_ALIVE = 1.5
"""For how many times of its watchdog a slave is watched."""
LONGEST_WATCHDOG_S = 5.0
"""Seconds: a slave whose watchdog is longer is watched no longer than that."""


TASKS = further.Further("ethercat", witness=oracle.WITNESS, was_read=calls.was_read, one_write=calls.one_write)


def some_outputs(run: Repetition) -> Asked:
    """Return the write of outputs of the terminal. Random ones are not those that a master repeats, which would be no write."""
    return outputs_of(TERMINAL).write(bytes_of(run.rng, TERMINAL))


further.ping(TASKS, "C1", "Ping the adapter and confirm that a slave answers.")

further.reads(
    TASKS,
    "C2",
    "Read an INT, a REAL and an UINT from the dictionary of a drive.",
    needs="read_sdo",
    make=lambda run: [TYPED[kind].read(TYPED[kind].kind.telling(run.rng)) for kind in ("INT32", "FLOAT32", "UINT16")],
)

further.reads_back(
    TASKS,
    "C3",
    "Write an object of a drive and read it back for verification.",
    needs="write_sdo read_sdo",
    write=lambda run: ACCELERATION.write(40 + run.rep, before=7),
    read=ACCELERATION.read_again,
    seen="One SDO download of two bytes, the less significant first; every other object and all outputs stay as they were.",
)


@TASKS.task(
    "C4",
    "normal",
    "Write the outputs of a slave.",
    needs="ethercat.write_outputs",
    capability="writing",
    requirements="WR-001 WR-002 WR-003",
)
async def write_outputs(run: Repetition, ethercat: Rig) -> None:
    """Write the two output bytes of slave 0.

    Said: these bytes.
    Seen: the slave is taken to OP, if it was not there; one change of its outputs, to these bytes; no other slave gets others.
    Why: a slave that is not in OP takes no outputs, whatever was sent.
    """
    asked = some_outputs(run)
    before = await ethercat.device.image()
    run.succeeds(await further.call(ethercat, asked), **asked.outputs)
    run.witnessed(
        calls.one_write(await ethercat.journal(), {}, asked),
        oracle.only_changed(before, await ethercat.device.image(), asked.points),
    )


@write_outputs.after
async def the_outputs_live_as_long_as_their_master(run: Repetition, ethercat: Rig) -> None:
    """Write, and wait for longer than the slave's watchdog; then end the session.

    Said: success.
    Seen: the slave still has the outputs, and a watchdog; after the session it clears them, because it leaves OP or because of its watchdog.
    Why: what is written once and not repeated falls at the watchdog; outputs that nobody answers for any more must not stay on.
    """
    asked = some_outputs(run)
    run.succeeds(await further.call(ethercat, asked), **asked.outputs)
    image = await ethercat.device.image()
    watchdog_s = oracle.watchdog_s(image, TERMINAL)
    await ethercat.watch(KEPT_ALIVE * min(watchdog_s or 0.0, LONGEST_WATCHDOG_S))
    run.witnessed(
        oracle.has_watchdog(image, TERMINAL),
        oracle.holds(await ethercat.device.image(), asked.points),
    )
    await ethercat.fresh_session()
    if watchdog_s is not None and oracle.cleared(await ethercat.device.image(), TERMINAL, requirement="MCP-009"):
        await further.watchdog(ethercat, watchdog_s, slave=TERMINAL)
    run.witnessed(oracle.cleared(await ethercat.device.image(), TERMINAL, requirement="MCP-009"))


@TASKS.task(
    "C5",
    "normal",
    "Attempt a write with writes disabled and expect a guarded rejection.",
    needs="ethercat.write_sdo ethercat.read_sdo ethercat.guard",
    capability="write_protection",
    requirements="WR-004 WR-005 ERR-006",
)
async def guarded_write(run: Repetition, ethercat_ro: Rig) -> None:
    """Write an object through the adapter that was started with writes disabled, and read another, and inputs where it reads them.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`; then the values.
    Seen: no SDO download, no outputs, and no request for OP; the slaves hold what they held.
    Why: who takes a slave to OP in order to read drives its outputs to zero.
    """
    reads = [TYPED["INT16"].any(run.rng)]
    if ethercat_ro.subject.claims("read_inputs"):
        reads.append(inputs_of(TERMINAL).read(bytes_of(run.rng, TERMINAL)))
    await further.set_up(ethercat_ro, *reads)
    before = await ethercat_ro.device.image()
    reply = await further.call(ethercat_ro, ACCELERATION.write(99))
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    for read in reads:
        run.succeeds(await further.call(ethercat_ro, read), **read.outputs)
    run.witnessed(
        oracle.nothing_driven(await ethercat_ro.journal()),
        oracle.only_changed(before, await ethercat_ro.device.image(), {}, otherwise="WR-004"),
    )


@guarded_write.after
async def the_guard_was_put_to_the_test(run: Repetition, ethercat: Rig, ethercat_ro: Rig) -> None:
    """Read with writes disabled, and write the same with writes enabled: both must work, or the refusal proves nothing. Then write through
    the adapter that was started with a write switch that means nothing.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`, unless the adapter refuses to start so.
    Seen: over the whole life of the read-only sessions, their end included, nothing that drives a slave.
    """
    read = TYPED["INT16"].reads()
    run.succeeds(await further.call(ethercat_ro, read))
    asked = ACCELERATION.write(run.rng.randrange(100, 900), before=7)
    await further.set_up(ethercat, asked)
    run.succeeds(await further.call(ethercat, asked), **asked.outputs)
    run.witnessed(
        oracle.some_exchange(await ethercat_ro.journal()),
        calls.one_write(await ethercat.journal(), {}, asked),
    )
    await ethercat_ro.close_session()
    run.witnessed(oracle.nothing_driven_by(await ethercat_ro.follow(oracle.Drives)))
    await a_meaningless_switch_enables_nothing(run, ethercat_ro, asked.operation, **asked.inputs)


@TASKS.task(
    "C6",
    "normal",
    "Read the state of a slave that has left OP.",
    needs="ethercat.read_state ethercat.write_outputs",
    capability="reading",
    requirements="RD-001 RD-004",
)
async def read_state(run: Repetition, ethercat: Rig) -> None:
    """Write outputs, read the state of their slave, and read it again after the slave has left OP by itself.

    Said: OP, and then SAFEOP.
    Seen: the slave is asked for its state during each call.
    Why: the state that a master has asked for is not the one in which a slave is.
    """
    asked = some_outputs(run)
    run.succeeds(await further.call(ethercat, asked), **asked.outputs)
    driven = await ethercat.call("read_state", slave=TERMINAL)
    # A master that takes it back to OP by itself would be right to say OP.
    await ethercat.device.poke(slave=TERMINAL, refuses=NO_OUTPUTS)
    await ethercat.device.poke(slave=TERMINAL, falls=NO_OUTPUTS)
    fallen = await ethercat.call("read_state", slave=TERMINAL)
    await ethercat.device.poke(slave=TERMINAL, refuses=None)
    run.succeeds(driven, state="OP")
    run.succeeds(fallen, state="SAFEOP")
    was_asked = partial(oracle.answered_by, slave=TERMINAL)
    run.witnessed(fresh(await ethercat.journal(), (driven, was_asked), (fallen, was_asked)))


@TASKS.task(
    "C7",
    "normal",
    "Find the slaves of the line.",
    needs="ethercat.scan_network",
    capability="reading",
    requirements="RD-001 RD-004",
)
async def scan_network(run: Repetition, ethercat: Rig) -> None:
    """Look for slaves while the last one is off the line, and again when it is back.

    Said: position 0; then 0 and 1.
    Seen: the slaves answer a request during each call.
    Why: a list from a configuration shows slaves that are not there.
    """
    await ethercat.device.poke(slave=DRIVE, present=False)
    one = await ethercat.call("scan_network")
    await ethercat.device.poke(slave=DRIVE, present=True)
    both = await ethercat.call("scan_network")
    run.succeeds(one, positions=[TERMINAL])
    run.succeeds(both, positions=[TERMINAL, DRIVE])
    run.witnessed(fresh(await ethercat.journal(), (one, oracle.some_exchange), (both, oracle.some_exchange)))


further.there(
    TASKS,
    further.missing(
        TASKS,
        "FC1",
        "Read an object that does not exist and expect a structured protocol error.",
        needs="read_sdo",
        key="missing_index",
        make=lambda missing: object_at(missing, 0, "UINT16").reads(),
        reached=calls.reached,
        refused=partial(oracle.refused_with, abort=NO_OBJECT),
        partly=False,
        seen="The upload, which the slave aborts with 06020000.",
    ),
    read=lambda run: TYPED["INT16"].any(run.rng),
    beyond=object_at(0x2001, 99, "INT16").reads(),
)

further.overflow(
    TASKS,
    "FC2",
    "Write an overflow value (70000 > 32767) to an INT16 and expect adapter rejection.",
    needs="write_sdo",
    make=lambda run: TYPED["INT16"].writes(70000),
    fits=lambda run, at: TYPED["INT16"].write(32767, before=7),
    why="70000 cut down to 16 bits is 4464, a value that nobody asked for.",
)

further.refused_by_itself(
    TASKS,
    "FC3",
    "Write a text to a FLOAT32 and expect adapter rejection.",
    needs="write_sdo",
    make=lambda run: TYPED["FLOAT32"].writes("abc"),
    why="Whatever four bytes a text becomes, they are a number that nobody asked for.",
)


@TASKS.task(
    "FC4",
    "fault",
    "Write objects that a slave refuses and expect the reasons.",
    needs="ethercat.write_sdo",
    capability="refusing",
    requirements="ERR-002 ERR-006",
)
async def write_what_is_refused(run: Repetition, ethercat: Rig) -> None:
    """Write an object that can only be read, and 5000 to one that takes 0 to 1000.

    Said: a failure with `not_writable`, and one with `illegal_value` or `range_overflow`; the outcomes `rejected` or `not_sent`.
    Seen: the slave aborts what reaches it, and every object is as before.
    Why: each of the reasons asks for something else: another object, or another value.
    """
    before = await ethercat.device.image()
    asked = object_at(0x1000, 0, "UINT32").writes(1), ACCELERATION.writes(5000)
    fixed, high = [await further.call(ethercat, one) for one in asked]
    outcomes = ("rejected", "not_sent")
    run.fails(fixed, "not_writable", outcome=outcomes, requirement="ERR-002")
    run.fails(high, "illegal_value", "range_overflow", outcome=outcomes, requirement="ERR-002")
    journal = await ethercat.journal()
    for reply, one, code in zip((fixed, high), asked, (READ_ONLY, TOO_HIGH), strict=True):
        seen = reply.during(journal)
        if oracle.was_sent(seen, index=one.inputs["index"]):
            run.witnessed(oracle.refused_with(seen, code))
    run.witnessed(oracle.only_changed(before, await ethercat.device.image(), {}, otherwise=untold(fixed, "ERR-002")))


@TASKS.task(
    "FC5",
    "fault",
    "Write outputs to a slave that refuses OP and expect the reason.",
    needs="ethercat.write_outputs",
    capability="refusing",
    requirements="ERR-002 ERR-006",
)
async def write_to_a_slave_that_refuses_op(run: Repetition, ethercat: Rig) -> None:
    """Write outputs to a slave that stays in SAFEOP with the AL status code 001D.

    Said: a failure with `config_error`, and the outcome `not_sent` or `rejected`.
    Seen: its outputs stay as they are.
    Why: a frame with outputs comes back also from a slave that does not take them.
    """
    await ethercat.device.poke(slave=TERMINAL, refuses=NO_OUTPUTS)
    await ethercat.device.poke(slave=TERMINAL, falls=NO_OUTPUTS)
    before = await ethercat.device.image()
    reply = await further.call(ethercat, some_outputs(run))
    after = await ethercat.device.image()
    await ethercat.device.poke(slave=TERMINAL, refuses=None)
    run.fails(reply, "config_error", "device_failure", outcome=("not_sent", "rejected"), requirement="ERR-002")
    run.witnessed(oracle.only_changed(before, after, {}, otherwise=untold(reply, "ERR-002")))


@TASKS.task(
    "FC6",
    "fault",
    "Read from a position at which there is no slave and expect a structured error.",
    needs="ethercat.read_sdo",
    capability="refusing",
    requirements="ERR-002 RD-005",
    keys="ethercat.probes.missing_slave",
)
async def read_missing_slave(run: Repetition, ethercat: Rig) -> None:
    """Read an object of a slave that does not exist.

    Said: a failure with `illegal_address`, `invalid_input` or `timeout`.
    Seen: nothing further.
    Why: a position that is counted from 1 reads another device, and looks right.
    """
    missing = ethercat.subject.probe("missing_slave")
    reply = await further.call(ethercat, object_at(0x1000, 0, "UINT32", missing).reads())
    run.fails(reply, "illegal_address", "invalid_input", "timeout", requirement="RD-005", code_requirement="ERR-002")


def four(run: Repetition) -> list[Asked]:
    """Return the reads of four objects."""
    return [TYPED[kind].any(run.rng) for kind in ("INT16", "UINT16", "INT32", "UINT32")]


further.four_at_once(
    TASKS,
    "SC1",
    "Four concurrent reads of objects.",
    needs="read_sdo",
    make=four,
    why="A slave has one mailbox: an answer that belongs to another call is a wrong value that looks right.",
)


def contended(run: Repetition) -> Contended:
    """Return a read and a write of an INT32."""
    return TYPED["INT32"].contended(*run.rng.sample(range(-(2**31), 2**31), 2))


further.beside(TASKS, "SC2", "Concurrent read and write of an object.", needs="read_sdo write_sdo", make=contended)


def fifty(run: Repetition) -> list[Asked]:
    """Return fifty reads of one object."""
    return [TYPED["UINT32"].any(run.rng)] * RAPID_CALLS


further.rapid(TASKS, "SC3", "Fifty reads of an object in a row.", needs="read_sdo", make=fifty)

further.restart(
    TASKS,
    "SC4",
    "Restart of the slaves between reads.",
    read_sdo=partial(
        oracle.object_was_read,
        **{name: TYPED["UINT32"].reads().inputs[name] for name in ("slave", "index", "subindex")},
    ),
    read_inputs=partial(oracle.inputs_were_read, slave=TERMINAL),
)

further.recovery(TASKS, "Recover from a restart of the EtherCAT slaves.")
