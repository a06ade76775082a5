"""The tasks on S7comm.

Each function is one repetition: the requests of the assistant, the expected envelopes, and the expected observations at the
controller. Values are different in every repetition, so that no cached or mixed-up answer can pass.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from pytest_otmcp.protocols.exercise import Asked, Contended
from pytest_otmcp.protocols.s7 import calls, oracle
from pytest_otmcp.protocols.s7.entries import points
from pytest_otmcp.protocols.s7.points import BLOCK, PLANT, of_bytes, value_at
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig

from . import further
from .common import RAPID_CALLS, fresh

__all__ = ["TASKS"]

BLOCK_SIZE = 64
OBJECT_DOES_NOT_EXIST, SERVICE_REFUSED = 0x0A, 0x8104


TASKS = further.Further("s7", witness=oracle.WITNESS, was_read=calls.was_read, one_write=calls.one_write)

further.ping(TASKS, "K1", "Ping the adapter and confirm that the controller answers.")


def sensor_block(run: Repetition) -> list[Asked]:
    """Return the read of three REAL, a DINT and a REAL."""
    one, two, three = (run.rng.uniform(-1e3, 1e3) for _ in range(3))
    content = oracle.content("3fif", one, two, three, run.rng.randrange(2**31), run.rng.uniform(-1e3, 1e3))
    return [of_bytes(0, len(content), PLANT).read(list(content))]


further.reads(
    TASKS,
    "K2",
    "Read a block of three REAL, a DINT and a REAL from a data block.",
    needs="read_db",
    make=sensor_block,
    asked="Read twenty bytes of the plant's data block, whose values were set at random just before.",
)

VERIFIED, FIRST = value_at(32), value_at(0)


def between_guards(run: Repetition) -> Asked:
    """Return a write with guard bytes on both sides: a write to, or a read from, a neighbouring value cannot pass."""
    value = 40 + run.rep
    return replace(VERIFIED.write(value), pokes=of_bytes(30, 6).pokes(oracle.content("3h", ~value, 0, ~value)))


further.reads_back(
    TASKS,
    "K3",
    "Write an INT to a data block and read it back for verification.",
    needs="write_db read_typed",
    write=between_guards,
    read=VERIFIED.read_again,
    seen="One write of one variable of two bytes, the more significant first; every other byte stays as it was.",
)

further.guard(
    TASKS,
    "K4",
    "Attempt a write with writes disabled and expect a guarded rejection.",
    needs="write_db read_typed",
    write=lambda run: FIRST.write(999),
    read=lambda run: FIRST.reads(),
    seen="No write, control, stop, download or set clock; {device} holds what it held.",
)


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
    await s7.device.poke(area="M", byte=3, data=f"{start:02x}")
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


further.there(
    TASKS,
    further.missing(
        TASKS,
        "FK1",
        "Read a data block that does not exist and expect a structured protocol error.",
        needs="read_typed",
        key="missing_db",
        make=lambda missing: value_at(0, db=missing).reads(),
        reached=calls.reached,
        refused=partial(oracle.refused_with, code=OBJECT_DOES_NOT_EXIST),
        seen="The read, which {device} refuses with the return code 0A.",
    ),
    read=lambda run: value_at(40).any(run.rng),
    beyond=value_at(BLOCK_SIZE - 2, "DINT").reads(),
)

further.overflow(
    TASKS,
    "FK2",
    "Write an overflow value (70000 > 32767) to an INT and expect adapter rejection.",
    needs="write_db",
    make=lambda run: FIRST.writes(70000),
    fits=lambda run, at: FIRST.write(32767),
    why="70000 cut down to 16 bits is 4464, a value that nobody asked for.",
)

further.refused_by_itself(
    TASKS,
    "FK3",
    "Write a text to a REAL and expect adapter rejection.",
    needs="write_db",
    make=lambda run: value_at(8, "REAL").writes("abc"),
    why="Whatever four bytes a text becomes, they are a number that nobody asked for.",
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
    asked = value_at(40).any(run.rng)
    await further.set_up(s7, asked)
    await s7.device.poke(put_get=False)
    refused = await further.call(s7, asked)
    await s7.device.poke(put_get=True)
    read = await further.call(s7, asked)
    run.fails(refused, "access_denied", "unsupported_operation", requirement="RD-005", code_requirement="ERR-002")
    run.succeeds(read, **asked.outputs)
    run.witnessed(oracle.refused_with(refused.during(await s7.journal()), SERVICE_REFUSED))


INTEGERS = range(-0x8000, 0x8000)


def four(run: Repetition) -> list[Asked]:
    """Return the reads of four INT beside one another."""
    return [value_at(2 * index).read(value) for index, value in enumerate(run.rng.sample(INTEGERS, 4))]


further.four_at_once(TASKS, "SK1", "Four concurrent reads of a data block.", needs="read_typed", make=four)


def contended(run: Repetition) -> Contended:
    """Return a read and a write of a DINT."""
    return value_at(12, "DINT").contended(*run.rng.sample(range(-(2**31), 2**31), 2))


further.beside(TASKS, "SK2", "Concurrent read and write of a data block.", needs="read_typed write_db", make=contended)


def fifty(run: Repetition) -> list[Asked]:
    """Return the reads of fifty INT."""
    values = run.rng.sample(INTEGERS, RAPID_CALLS)
    return [value_at(100 + 2 * index, db=PLANT).read(value) for index, value in enumerate(values)]


further.rapid(TASKS, "SK3", "Fifty reads of a data block in a row.", needs="read_typed", make=fifty)

further.restart(
    TASKS,
    "SK4",
    "Endpoint restart between reads of a data block.",
    read_db=partial(oracle.read_from_device, db=BLOCK, start=0, size=8),
)

further.recovery(TASKS, "Recover from a restart of the S7 controller.")
