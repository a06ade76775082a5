"""The tasks on S7comm.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
controller. Values are different in every repetition, so that no cached or mixed-up answer can pass.
"""

from __future__ import annotations

from functools import partial

from pytest_otmcp.protocols.s7 import oracle
from pytest_otmcp.protocols.s7.entries import points
from pytest_otmcp.protocols.session_oracle import StateChanges
from pytest_otmcp.trial.repetition import Repetition
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

PLANT, CLIENTS = 1, 10
"""Data blocks: the plant's and the clients'."""
BLOCK = f"DB{CLIENTS}"
BLOCK_SIZE = 64
OBJECT_DOES_NOT_EXIST, INVALID_ADDRESS, SERVICE_REFUSED = 0x0A, 0x05, 0x8104
INT_RANGE = range(-0x8000, 0x8000)


def bytes_of(db: int, start: int, size: int) -> Witness:
    """Return the check that the controller was asked for these bytes."""
    return partial(oracle.read_from_device, db=db, start=start, size=size)


async def set_bytes(s7: Rig, area: str, byte: int, content: bytes) -> None:
    """Set bytes at the controller past the protocol."""
    await s7.device.poke(area=area, byte=byte, data=content.hex())


@TASKS.task(
    "K1",
    "normal",
    "Ping the adapter and confirm that the controller answers.",
    needs="s7.ping",
    capability="reading",
    requirements="REC-002 MCP-008",
)
async def ping(run: Repetition, s7: Rig) -> None:
    """Ask whether the controller can be reached.

    Said: success, and that it can be reached.
    Seen: the controller answers at least one request during the call.
    Why: a status from memory still says so when the plant is gone.
    """
    reply = await s7.call("ping")
    run.succeeds(reply, reachable=True)
    await status_is_known(run, s7, oracle.some_exchange, reply)


@ping.after
async def a_slow_controller_is_reported_as_slow(run: Repetition, s7: Rig) -> None:
    """Ping while the controller answers a tenth of a second late.

    Said: success, and a latency that is no shorter than that.
    """
    await a_delay_shows(run, s7, "ping")


@TASKS.task(
    "K2",
    "normal",
    "Read a block of three REAL, a DINT and a REAL from a data block.",
    needs="s7.read_db",
    capability="reading",
    requirements="RD-001 RD-002 RD-004 MCP-009",
)
async def read_sensor_block(run: Repetition, s7: Rig) -> None:
    """Read twenty bytes of the plant's data block, whose values were set at random just before.

    Said: these bytes.
    Seen: a read of these bytes, and nothing that changes the controller.
    Why: values from memory, of another data block or in another byte order look right until somebody acts on them.
    """
    values = oracle.content(
        "3fif", *(run.rng.uniform(-1e3, 1e3) for _ in range(3)), run.rng.randrange(2**31), run.rng.uniform(-1e3, 1e3)
    )
    await set_bytes(s7, f"DB{PLANT}", 0, values)
    reply = await s7.call("read_db", db=PLANT, start=0, size=len(values))
    run.succeeds(reply, values=list(values))
    journal = await s7.journal()
    run.witnessed(
        fresh(journal, (reply, bytes_of(PLANT, 0, len(values)))),
        oracle.no_state_changing_request(journal, requirement="MCP-008"),
        oracle.holds(await s7.device.image(), points(f"DB{PLANT}", 0, values)),
    )


@read_sensor_block.after
async def the_process_ends_with_its_stdin(run: Repetition, s7: Rig) -> None:
    """End the session.

    Seen: the process ends by itself.
    """
    await ends_when_its_stdin_closes(s7)


@TASKS.task(
    "K3",
    "normal",
    "Write an INT to a data block and read it back for verification.",
    needs="s7.write_db s7.read_typed",
    capability="writing",
    requirements="WR-001 WR-002 WR-003",
)
async def write_and_read_back(run: Repetition, s7: Rig) -> None:
    """Write an INT, and read it.

    Said: the value that was written, in both answers.
    Seen: one write of one variable of two bytes, the more significant first; every other byte stays as it was.
    Why: an adapter that says "written" may have written twice, beside the value, with its bytes swapped, or not at all.
    """
    value = 40 + run.rep
    written = oracle.content("h", value)
    # Guard bytes on both sides: a write to, or a read from, a neighbouring value cannot pass.
    await set_bytes(s7, BLOCK, 30, oracle.content("3h", ~value, 0, ~value))
    before = await s7.device.image()
    wrote = await s7.call("write_db", db=CLIENTS, start=32, type="INT", value=value)
    after = await s7.device.image()
    read = await s7.call("read_typed", db=CLIENTS, start=32, type="INT")
    run.succeeds(wrote, value=value)
    # What the controller holds now may not be the value, which is the fault of the write; the read has to tell it.
    run.succeeds(read, value=int.from_bytes(oracle.held(after, BLOCK, 32, 2), "big", signed=True))
    journal = await s7.journal()
    run.witnessed(
        oracle.exactly_one_write(journal, db=CLIENTS, start=32, written=written),
        fresh(journal, (read, bytes_of(CLIENTS, 32, 2))),
        oracle.only_changed(before, after, points(BLOCK, 32, written)),
    )


@TASKS.task(
    "K4",
    "normal",
    "Attempt a write with writes disabled and expect a guarded rejection.",
    needs="s7.write_db s7.read_typed s7.guard",
    capability="write_protection",
    requirements="WR-004 WR-005 ERR-006",
)
async def guarded_write(run: Repetition, s7_ro: Rig) -> None:
    """Write a value through the adapter that was started with writes disabled.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`.
    Seen: no write, control, stop, download or set clock; the controller holds what it held.
    Why: the write switch is what keeps an assistant's mistake out of the plant.
    """
    before = await s7_ro.device.image()
    reply = await s7_ro.call("write_db", db=CLIENTS, start=0, type="INT", value=999)
    run.fails(reply, "writes_disabled", outcome="not_sent", requirement="WR-004")
    run.witnessed(
        oracle.no_state_changing_request(await s7_ro.journal()),
        oracle.only_changed(before, await s7_ro.device.image(), {}, otherwise="WR-004"),
    )


@guarded_write.after
async def the_guard_was_put_to_the_test(run: Repetition, s7: Rig, s7_ro: Rig) -> None:
    """Read with writes disabled, and write the same value with writes enabled: both must work, or the refusal proves
    nothing. Then write through the adapter that was started with a write switch that means nothing.

    Said: a refusal with `writes_disabled` and the outcome `not_sent`, unless the adapter refuses to start so.
    Seen: over the whole life of the read-only sessions, their end included, nothing that changes the controller.
    """
    read = await s7_ro.call("read_typed", db=CLIENTS, start=0, type="INT")
    run.succeeds(read)
    written = await s7.call("write_db", db=CLIENTS, start=0, type="INT", value=999)
    run.succeeds(written, value=999)
    run.witnessed(
        oracle.some_exchange(await s7_ro.journal()),
        oracle.exactly_one_write(await s7.journal(), db=CLIENTS, start=0, written=oracle.content("h", 999)),
    )
    # This controller's journal holds the whole life of the read-only session, its closing included, and nothing else.
    await s7_ro.close_session()
    run.witnessed(oracle.nothing_changed_by(await s7_ro.follow(StateChanges)))
    await a_meaningless_switch_enables_nothing(run, s7_ro, "write_db", db=CLIENTS, start=0, type="INT", value=999)


@TASKS.task(
    "K5",
    "normal",
    "Write one bit of the flags while its neighbour changes.",
    needs="s7.write_marker",
    capability="writing",
    requirements="WR-011 WR-002",
)
async def write_one_bit(run: Repetition, s7: Rig) -> None:
    """Set the bit M3.5, while the bit M3.6 turns before every request.

    Said: success.
    Seen: one write of one bit; every other bit is as the plant left it.
    Why: who reads a byte, changes a bit and writes the byte takes back what the program has done meanwhile.
    """
    start = run.rng.randrange(0x100) & ~0x20
    await set_bytes(s7, "M", 3, bytes([start]))
    await s7.device.poke(restless=[{"area": "M", "byte": 3, "bits": 0x40}])
    before = await s7.device.image()
    reply = await s7.call("write_marker", byte=3, bit=5, value=True)
    after = await s7.device.image()
    await s7.device.poke(restless=[])
    run.succeeds(reply, value=True)
    turned = 0x40 if oracle.changes_of_restless_bits(after) % 2 else 0
    run.witnessed(
        oracle.exactly_one_bit_write(await s7.journal(), byte=3, bit=5, value=True),
        oracle.only_changed(before, after, points("M", 3, bytes([start ^ turned | 0x20]))),
    )


@TASKS.task(
    "K6",
    "normal",
    "Read the operating state of a CPU that was stopped.",
    needs="s7.read_cpu_state",
    capability="reading",
    requirements="RD-001 RD-004",
)
async def read_operating_state(run: Repetition, s7: Rig) -> None:
    """Read the operating state after somebody has stopped the CPU, and after it was started again.

    Said: STOP, and then RUN.
    Seen: the controller answers a request during each call.
    Why: a client that says RUN whatever the controller answers hides that nothing is controlled any more.
    """
    await s7.device.poke(cpu="STOP")
    stopped = await s7.call("read_cpu_state")
    await s7.device.poke(cpu="RUN")
    running = await s7.call("read_cpu_state")
    run.succeeds(stopped, state="STOP")
    run.succeeds(running, state="RUN")
    run.witnessed(fresh(await s7.journal(), (stopped, oracle.some_exchange), (running, oracle.some_exchange)))


@TASKS.task(
    "K7",
    "normal",
    "Stop the CPU and start it again.",
    needs="s7.set_cpu_state",
    capability="writing",
    requirements="WR-001 WR-003",
)
async def stop_and_start(run: Repetition, s7: Rig) -> None:
    """Stop the CPU through the adapter, and start it.

    Said: STOP, and then RUN.
    Seen: one request to stop and one to start; the CPU is in the state that was said each time.
    Why: a command that was acknowledged and not carried out leaves a machine running that everybody believes to stand.
    """
    stopped = await s7.call("set_cpu_state", state="STOP")
    halted = await s7.device.image()
    started = await s7.call("set_cpu_state", state="RUN")
    after = await s7.device.image()
    # A CPU that has not been started again would stay so for all items that follow.
    await s7.device.poke(cpu="RUN")
    run.succeeds(stopped, state="STOP")
    run.succeeds(started, state="RUN")
    journal = await s7.journal()
    run.witnessed(
        oracle.one_control(stopped.during(journal), "stop"),
        oracle.one_control(started.during(journal), "control"),
        oracle.holds(halted, {"CPU": "STOP"}),
        oracle.holds(after, {"CPU": "RUN"}),
    )


@TASKS.task(
    "FK1",
    "fault",
    "Read a data block that does not exist and expect a structured protocol error.",
    needs="s7.read_typed",
    capability="refusing",
    requirements="ERR-002 ENV-007 RD-005 RD-007",
    keys="s7.probes.missing_db",
)
async def read_missing_block(run: Repetition, s7: Rig) -> None:
    """Read a data block that the controller does not have.

    Said: a failure with `illegal_address`. An adapter that refuses by a list of its own may also say `invalid_input`; nothing was
        sent then.
    Seen: the read, which the controller refuses with the return code 0A.
    Why: an assistant that gets a zero for a data block that does not exist believes the zero.
    """
    missing = s7.subject.probe("missing_db")
    reply = await s7.call("read_typed", db=missing, start=0, type="INT")
    seen = reply.during(await s7.journal())
    if not oracle.reached(seen, db=missing, start=0, size=2):
        run.fails(reply, "illegal_address", "invalid_input", outcome=NOTHING_SENT, requirement="ERR-002")
        return
    run.fails(reply, "illegal_address", requirement="ERR-002")
    run.witnessed(oracle.refused_with(seen, OBJECT_DOES_NOT_EXIST))


@read_missing_block.after
async def what_is_there_can_be_read_and_nothing_follows_the_end(run: Repetition, s7: Rig) -> None:
    """Read a value that is there: a refusal proves something only if the same call works elsewhere. Then read a DINT of which only
    a half lies in the data block.

    Said: success and the value; then a failure with `illegal_address`, `invalid_input` or `limit_exceeded`.
    """
    value = run.rng.choice(INT_RANGE)
    await set_bytes(s7, BLOCK, 40, oracle.content("h", value))
    run.succeeds(await s7.call("read_typed", db=CLIENTS, start=40, type="INT"), value=value)
    beyond = await s7.call("read_typed", db=CLIENTS, start=BLOCK_SIZE - 2, type="DINT")
    run.fails(
        beyond, "illegal_address", "invalid_input", "limit_exceeded", requirement="RD-007", code_requirement="ERR-002"
    )


@TASKS.task(
    "FK2",
    "fault",
    "Write an overflow value (70000 > 32767) to an INT and expect adapter rejection.",
    needs="s7.write_db",
    capability="refusing",
    requirements="ADR-003 ADR-004 ERR-006",
)
async def write_overflow(run: Repetition, s7: Rig) -> None:
    """Write 70000 to an INT.

    Said: a failure with `range_overflow` and the outcome `not_sent`.
    Seen: no request that changes the controller; it holds what it held.
    Why: 70000 cut down to 16 bits is 4464, a value that nobody asked for.
    """
    before = await s7.device.image()
    reply = await s7.call("write_db", db=CLIENTS, start=0, type="INT", value=70000)
    run.fails(reply, "range_overflow", outcome="not_sent", requirement="ADR-003")
    run.witnessed(
        oracle.no_state_changing_request(await s7.journal(), requirement=untold(reply, "ADR-003")),
        oracle.only_changed(before, await s7.device.image(), {}, otherwise=untold(reply, "ADR-003")),
    )


@write_overflow.after
async def the_largest_value_is_accepted(run: Repetition, s7: Rig) -> None:
    """Write 32767, which fits.

    Said: success.
    Seen: one write, and the value in the data block.
    """
    await s7.stays_quiet(QUIET_S, partial(oracle.no_state_changing_request, requirement="ADR-003"))
    run.succeeds(await s7.call("write_db", db=CLIENTS, start=0, type="INT", value=32767), value=32767)
    largest = oracle.content("h", 32767)
    run.witnessed(
        oracle.exactly_one_write(await s7.journal(), db=CLIENTS, start=0, written=largest),
        oracle.holds(await s7.device.image(), points(BLOCK, 0, largest)),
    )


@TASKS.task(
    "FK3",
    "fault",
    "Write a text to a REAL and expect adapter rejection.",
    needs="s7.write_db",
    capability="refusing",
    requirements="ADR-004 ERR-006",
)
async def write_wrong_type(run: Repetition, s7: Rig) -> None:
    """Write "abc" to a REAL.

    Said: a failure with `type_mismatch` or `invalid_input`, and the outcome `not_sent`.
    Seen: no request that changes the controller; it holds what it held.
    Why: whatever four bytes a text becomes, they are a number that nobody asked for.
    """
    before = await s7.device.image()
    reply = await s7.call("write_db", db=CLIENTS, start=8, type="REAL", value="abc")
    run.fails(reply, "type_mismatch", "invalid_input", outcome="not_sent", requirement="ADR-004")
    run.witnessed(
        oracle.no_state_changing_request(await s7.journal(), requirement=untold(reply, "ADR-004")),
        oracle.only_changed(before, await s7.device.image(), {}, otherwise=untold(reply, "ADR-004")),
    )


@TASKS.task(
    "FK4",
    "fault",
    "Read while PUT/GET communication is not permitted and expect access denied.",
    needs="s7.read_typed",
    capability="refusing",
    requirements="ERR-002 RD-005",
)
async def read_what_is_not_permitted(run: Repetition, s7: Rig) -> None:
    """Read from a CPU that does not permit PUT/GET communication, as 1200 and 1500 are delivered; then from one that does.

    Said: a failure with `access_denied` or `unsupported_operation`; then the value.
    Seen: the controller refuses with the error 8104.
    Why: an empty answer for a refused read looks like a plant without values.
    """
    value = run.rng.choice(INT_RANGE)
    await set_bytes(s7, BLOCK, 40, oracle.content("h", value))
    await s7.device.poke(put_get=False)
    refused = await s7.call("read_typed", db=CLIENTS, start=40, type="INT")
    await s7.device.poke(put_get=True)
    read = await s7.call("read_typed", db=CLIENTS, start=40, type="INT")
    run.fails(refused, "access_denied", "unsupported_operation", requirement="RD-005", code_requirement="ERR-002")
    run.succeeds(read, value=value)
    run.witnessed(oracle.refused_with(refused.during(await s7.journal()), SERVICE_REFUSED))


@TASKS.task(
    "SK1",
    "stress",
    "Four concurrent reads of a data block.",
    needs="s7.read_typed",
    capability="load",
    requirements="CON-001",
)
async def concurrent_reads(run: Repetition, s7: Rig) -> None:
    """Read four INT by four calls at the same time.

    Said: in each answer the value of its own address.
    Seen: for each call a read that covers its address, during the call.
    Why: an answer that belongs to another call is a wrong value that looks right.
    """
    values = run.rng.sample(INT_RANGE, 4)
    await set_bytes(s7, BLOCK, 0, oracle.content("4h", *values))
    starts = range(0, 8, 2)
    replies = await run.together(*(s7.call("read_typed", db=CLIENTS, start=start, type="INT") for start in starts))
    for reply, value in zip(replies, values, strict=True):
        run.succeeds(reply, value=value)
    asked = [(reply, bytes_of(CLIENTS, start, 2)) for reply, start in zip(replies, starts, strict=True)]
    run.witnessed(fresh(await s7.journal(), *asked))


@TASKS.task(
    "SK2",
    "stress",
    "Concurrent read and write of a data block.",
    needs="s7.read_typed s7.write_db",
    capability="load",
    requirements="CON-004 WR-003",
)
async def concurrent_read_and_write(run: Repetition, s7: Rig) -> None:
    """Read a DINT and write it at the same time.

    Said: the old value or the new one for the read, success for the write.
    Seen: one write; the data block holds the new value.
    Why: a mixture of two values, or a lost write, shows only under load.
    """
    inputs = {"db": CLIENTS, "start": 12, "type": "DINT"}
    old, new = drawn(
        s7,
        "write_db",
        lambda: run.rng.sample(range(-(2**31), 2**31), 2),
        lambda pair: {**inputs, "value": pair[1]},
    )
    await set_bytes(s7, BLOCK, 12, oracle.content("i", old))
    read, written = await run.together(
        s7.call("read_typed", db=CLIENTS, start=12, type="DINT"),
        s7.call("write_db", db=CLIENTS, start=12, type="DINT", value=new),
    )
    run.succeeds(read)
    run.one_of(read, "value", old, new)
    run.succeeds(written, value=new)
    run.witnessed(
        oracle.exactly_one_write(await s7.journal(), db=CLIENTS, start=12, written=oracle.content("i", new)),
        oracle.holds(await s7.device.image(), points(BLOCK, 12, oracle.content("i", new))),
    )


@TASKS.task(
    "SK3",
    "stress",
    "Fifty reads of a data block in a row.",
    needs="s7.read_typed",
    capability="load",
    requirements="CON-006",
)
async def rapid_reads(run: Repetition, s7: Rig) -> None:
    """Read fifty INT, one call after the other.

    Said: the right value in every answer.
    Seen: for each call a read that covers its address, during the call.
    Why: leaks, caches and connections that are used up show in a long series only.
    """
    values = run.rng.sample(INT_RANGE, RAPID_CALLS)
    await set_bytes(s7, f"DB{PLANT}", 100, oracle.content(f"{RAPID_CALLS}h", *values))
    asked = []
    for index, value in enumerate(values):
        start = 100 + 2 * index
        reply = await s7.call("read_typed", db=PLANT, start=start, type="INT")
        run.succeeds(reply, value=value)
        asked.append((reply, bytes_of(PLANT, start, 2)))
    run.witnessed(fresh(await s7.journal(), *asked))


@TASKS.task(
    "SK4",
    "stress",
    "Endpoint restart between reads of a data block.",
    needs="s7.any_read s7.recovery",
    capability="outages",
    requirements="REC-001 REC-002 RD-004",
    keys="s7.recovery",
)
async def restart(run: Repetition, s7: Rig) -> None:
    """Read eight bytes; again after the controller was stopped; and again after it was started.

    Said: success; then a failure with `connect_failed`, `connection_lost` or `timeout`; then success in the same
        session.
    Seen: a read after the controller is back.
    Why: an outage of the line must not need a person who restarts the adapter, and old values must not hide it.
    """
    await survive_a_restart(run, s7, read_db=bytes_of(CLIENTS, 0, 8))


@restart.after
async def a_failed_write_is_not_delivered_later(run: Repetition, s7: Rig) -> None:
    """Write while the controller is away, and read when it is back.

    Said: a failure for the write, success for the read.
    Seen: no write: what was reported as failed is not made up for.
    """
    await a_failed_write_is_not_made_up_for(run, s7)


@TASKS.task(
    "R-s7",
    "recovery",
    "Recover from a restart of the S7 controller.",
    needs="s7.any_read",
    capability="outages",
    requirements="REC-001 REC-002 MCP-009",
    keys="s7.recovery",
)
async def recovery(run: Repetition, s7: Rig) -> None:
    """Read; again after the controller was stopped; then, after it was started, in the same session and in a fresh one with
    a new process.

    Said: success; a failure of the connection; success in both sessions.
    Seen: the reads of both sessions, and nothing that changes the plant.
    Why: how soon an outage is noticed, and how soon work goes on, decides what the adapter can be used for.
    """
    await outage(run, s7)


@recovery.after
async def the_adapter_starts_without_its_controller(run: Repetition, s7: Rig) -> None:
    """Start the adapter while its controller is down, ask, and ask again when it is there.

    Said: a failure of the connection first, success then.
    """
    await start_without_device(run, s7)
