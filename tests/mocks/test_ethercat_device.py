"""The mock EtherCAT segment with two masters of other authors: SOEM and KickCAT."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import struct
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from mock_program import PATIENCE_S, MockProgram

from pytest_otmcp.protocols.ethercat.oracle import answered_by, drives
from pytest_otmcp.session.cable import cable_refused
from pytest_otmcp.wire.ethercat import (
    AL_CONTROL,
    AL_STATUS,
    MAILBOX_BYTES,
    MAILBOX_IN,
    MAILBOX_OUT,
    OUTPUTS,
    Datagram,
    encoded,
    parse,
)

pytestmark = [
    pytest.mark.asyncio,
    pytest.mark.skipif(cable_refused() is not None, reason=f"no cable here: {cable_refused()}"),
]
ETHERNET = bytes.fromhex("ffffffffffff 020000000001 88a4")
HERE = Path(__file__).parent
WORKER = HERE.parents[1] / "reference_adapters" / "ethercat" / "worker.py"


@pytest_asyncio.fixture
async def segment(start_mock: Callable[..., Awaitable[MockProgram]]) -> MockProgram:
    return await start_mock("ethercat")


def within(program: MockProgram, *command: str) -> list[str]:
    cable = program.ready_event["endpoints"]["ethercat"]
    join = ["nsenter", "-t", str(cable["join"]), "-U", "-n", "--preserve-credentials"]
    return [*join, sys.executable, "-P", *(word.format(cable["path"]) for word in command)]


class Line:
    """A master that sends frames as they are told."""

    def __init__(self, relay: asyncio.subprocess.Process) -> None:
        self._relay = relay

    async def passed(self, *datagrams: Datagram) -> list[Datagram]:
        """Send a frame, and return what comes back."""
        assert self._relay.stdin is not None
        assert self._relay.stdout is not None
        self._relay.stdin.write(encoded(ETHERNET, list(datagrams)).hex().encode() + b"\n")
        async with asyncio.timeout(PATIENCE_S):
            return parse(bytes.fromhex((await self._relay.stdout.readline()).decode()))

    async def set_up(self) -> None:
        """Take the first slave to OP; its outputs are at the logical address 0."""
        await self.passed(Datagram(command=2, index=1, position=0, offset=0x10, data=b"\x01\x10"))
        manager = struct.pack("<HHBBBB", OUTPUTS, 2, 0x64, 0, 1, 0)
        unit = struct.pack("<IHBBHBBB", 0, 2, 0, 7, OUTPUTS, 0, 2, 1) + bytes(3)
        for offset, data in (
            (0x810, manager),
            (0x600, unit),
            *((AL_CONTROL, bytes([state, 0])) for state in (2, 4, 8)),
        ):
            await self.passed(Datagram(command=5, index=1, position=0x1001, offset=offset, data=data))


@pytest_asyncio.fixture
async def line(segment: MockProgram) -> AsyncIterator[Line]:
    relay = await asyncio.create_subprocess_exec(
        *within(segment, str(HERE / "cable_relay.py"), "{}", "88a4"), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert relay.stdout is not None
    assert relay.stdin is not None
    await relay.stdout.readline()
    yield Line(relay)
    relay.stdin.close()
    await relay.wait()


async def test_each_datagram_of_a_frame_is_told(segment: MockProgram, line: Line) -> None:
    await line.set_up()
    before = (await segment.control.journal())[-1]["seq"]
    state = Datagram(command=4, index=1, position=0x1001, offset=AL_STATUS, data=bytes(2))
    back = await line.passed(state, Datagram(command=12, index=1, position=0, offset=0, data=b"\x0a\x0b"))
    assert [one.counter for one in back] == [1, 2]
    assert (await segment.control.points())["0.output.0"] == 10
    entries = [entry for entry in await segment.control.journal() if entry["seq"] > before]
    requests, answers = entries[:2], entries[2:]
    assert [(one["service"], one["slave"], one["state_changing"]) for one in requests] == [
        ("al_status", 0, False),
        ("process_data", 0, True),
    ]
    assert [one["answers"] for one in answers] == [one["seq"] for one in requests]
    assert drives(requests[1])
    assert answered_by(entries, slave=0) == []


async def test_a_state_that_all_slaves_are_asked_for_is_that_of_each(segment: MockProgram, line: Line) -> None:
    await line.passed(Datagram(command=7, index=1, position=0, offset=AL_STATUS, data=bytes(2)))
    entries = await segment.control.journal()
    assert answered_by(entries, slave=0) == answered_by(entries, slave=1) == []


async def test_a_mailbox_without_a_message_is_not_read(line: Line) -> None:
    await line.passed(Datagram(command=2, index=1, position=0xFFFF, offset=AL_CONTROL, data=b"\x02\0"))
    manager = struct.pack("<HHBBBB", MAILBOX_IN, MAILBOX_BYTES, 0x22, 0, 1, 0)
    await line.passed(Datagram(command=2, index=1, position=0xFFFF, offset=0x808, data=manager))
    [found] = await line.passed(
        Datagram(command=1, index=1, position=0xFFFF, offset=MAILBOX_IN, data=bytes(MAILBOX_BYTES))
    )
    assert found.counter == 0


async def test_an_answer_that_is_held_back_is_not_that_of_the_next_item(segment: MockProgram, line: Line) -> None:
    await line.passed(Datagram(command=2, index=1, position=0xFFFF, offset=AL_CONTROL, data=b"\x02\0"))
    await segment.control.fault({"delay_s": 0.05}, service="sdo_upload")
    asked = (b"\x0a\0\0\0\0\x13\0\x20\x40\x01\x20\x02" + bytes(4)).ljust(MAILBOX_BYTES, b"\0")
    await line.passed(Datagram(command=2, index=1, position=0xFFFF, offset=MAILBOX_OUT, data=asked))
    await segment.control.ask("reset")
    # Nothing tells of what does not come.
    await asyncio.sleep(0.1)
    [found] = await line.passed(
        Datagram(command=1, index=1, position=0xFFFF, offset=MAILBOX_IN, data=bytes(MAILBOX_BYTES))
    )
    assert found.data == bytes(MAILBOX_BYTES)


@pytest.mark.long
@pytest.mark.skipif(importlib.util.find_spec("kickcat") is None, reason="kickcat is not installed")
async def test_kickcat_takes_both_slaves_to_op(segment: MockProgram) -> None:
    await segment.control.poke(slave=1, object=[0x2001, 5], data="c01dfeff")
    await segment.control.poke(slave=0, inputs="cf00")
    master = await asyncio.create_subprocess_exec(
        *within(segment, str(HERE / "kickcat_master.py"), "{}"), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    said, complained = await master.communicate()
    assert master.returncode == 0, complained.decode()
    told = json.loads(said.splitlines()[-1])
    assert told == {"sizes": [[2, 2], [8, 8]], "name": "OTMCP-DRIVE", "read": -123456, "inputs": [207, 0]}
    assert [
        entry["outputs"] for entry in await segment.control.journal(kind="request", slave=0) if "outputs" in entry
    ] == ["0304"]
    # Nobody drives the slaves any more.
    await segment.control.wait(kind="watchdog", slave=0)
    assert (await segment.control.image())["slaves"][0]["state"] == "SAFEOP"


async def test_soem_drives_a_slave_until_it_ends(segment: MockProgram) -> None:
    pytest.importorskip("pysoem")
    worker = await asyncio.create_subprocess_exec(
        *within(segment, str(WORKER), "{}", "2", "0.02", "1"), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert worker.stdin is not None
    assert worker.stdout is not None

    async def ask(**request: Any) -> Any:
        assert worker.stdin is not None
        assert worker.stdout is not None
        worker.stdin.write(json.dumps(request).encode() + b"\n")
        return json.loads(await worker.stdout.readline())

    assert (await ask(op="open"))["ok"]["slaves"] == 2
    assert (await ask(op="drive", position=0, data="0102"))["ok"] == "0102"
    assert (await segment.control.points())["0.output.0"] == 1
    assert await ask(op="upload", position=1, index=0x2222, subindex=0) == {"error": "abort", "code": 0x06020000}
    await segment.control.poke(slave=1, refuses=0x1D)
    refused = await ask(op="drive", position=1, data="01" * 8)
    assert refused == {"error": "state", "code": 0x1D, "state": "SAFEOP"}
    worker.stdin.close()
    await worker.wait()
    [expired] = await segment.control.wait(kind="watchdog")
    assert (expired["slave"], expired["outputs"]) == (0, "0102")
    assert (await segment.control.points())["0.output.0"] == 0
