"""A controller on the cable of the PROFINET mock that sends frames as they are, and reads them by the kit's codec."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mock_program import PATIENCE_S, MockProgram

from pytest_otmcp.wire.profinet import dcp
from pytest_otmcp.wire.profinet.blocks import (
    CONTROLLER,
    INPUTS,
    OUTPUTS,
    PARAMETERS_END,
    RELEASED,
    SUPERVISOR,
    Control,
    CyclicData,
    Module,
    Record,
    Relation,
    Submodule,
    blocks_of,
)
from pytest_otmcp.wire.profinet.dcp import Dcp
from pytest_otmcp.wire.profinet.frames import IPV4, PROFINET, RPC_PORT, Datagram, Frame
from pytest_otmcp.wire.profinet.rpc import (
    CONNECT,
    CONTROL,
    DEVICE_INTERFACE,
    READ_IMPLICIT,
    RELEASE,
    WRITE,
    Kind,
    Rpc,
    swapped,
)
from pytest_otmcp.wire.profinet.rt import GOOD, RtFrame

__all__ = ["MODULES", "MULTICAST", "NAME", "Controller"]

MULTICAST = bytes.fromhex("010ecf000000")
NAME = "kit-device"
OWN, DEVICE = ("10.77.0.1", 50_000), ("10.77.0.2", RPC_PORT)
MODULES = (
    Module(slot=1, identifier=0x10, submodules={1: Submodule(identifier=1, inputs=8)}),
    Module(slot=2, identifier=0x20, submodules={1: Submodule(identifier=1, outputs=8)}),
)
_OBJECT = bytes.fromhex("dea000006c9711d18271000100010abc")
_EVERY_PROTOCOL = "3"


class Controller:
    """A client in the network of the cable."""

    def __init__(self, process: asyncio.subprocess.Process, mac: bytes, device: bytes) -> None:
        self.mac, self.device = mac, device
        self.relation = os.urandom(16)
        self._process = process
        self._activity, self._sequence = os.urandom(16), -1
        self._xid = 0
        self.sent: list[bytes] = []

    @classmethod
    async def join(cls, program: MockProgram) -> Controller:
        address = next(iter(program.ready_event["endpoints"].values()))
        process = await asyncio.create_subprocess_exec(
            *("nsenter", "-t", str(address["join"]), "-U", "-n", "--preserve-credentials"),
            *(sys.executable, str(Path(__file__).with_name("cable_relay.py")), address["path"], _EVERY_PROTOCOL),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert process.stdout is not None
        mac = bytes.fromhex((await process.stdout.readline()).decode())
        return cls(process, mac, bytes.fromhex(address["mac"].replace(":", "")))

    def send(self, payload: bytes, *, to: bytes | None = None, ethertype: int = PROFINET) -> None:
        frame = Frame(destination=to or self.device, source=self.mac, ethertype=ethertype, payload=payload)
        self.send_raw(frame.encoded())

    def send_raw(self, raw: bytes) -> None:
        assert self._process.stdin is not None
        self.sent.append(raw)
        self._process.stdin.write(raw.hex().encode() + b"\n")

    async def frame(self, wanted: Callable[[Frame], Any] = lambda frame: True) -> Frame:
        """Return the next frame that is wanted."""
        assert self._process.stdout is not None
        async with asyncio.timeout(PATIENCE_S):
            while True:
                found = Frame.parse(bytes.fromhex((await self._process.stdout.readline()).decode()))
                if wanted(found):
                    return found

    async def dcp(self, service: int, *blocks: dcp.Block, to: bytes | None = None) -> Dcp:
        """Ask a station, and return its answer; an Identify asks all of them."""
        identifies = service == dcp.IDENTIFY
        self._xid += 1
        frame_id = dcp.IDENTIFY_REQUEST if identifies else dcp.GET_OR_SET
        asked = Dcp(frame_id=frame_id, service=service, xid=self._xid, blocks=blocks)
        self.send(asked.encoded(), to=to or (MULTICAST if identifies else None))
        found = await self.frame(lambda frame: frame.ethertype == PROFINET and frame.payload[0] == 0xFE)
        return Dcp.parse(found.payload)

    async def call(self, operation: int, blocks: bytes, *, again: bool = False, little: bool = False) -> Rpc:
        """Call the device, and return its answer; ``again`` repeats the number of the last call."""
        self._sequence += not again
        asked = Rpc(
            kind=Kind.REQUEST,
            operation=operation,
            sequence=self._sequence,
            object=_OBJECT,
            interface=swapped(DEVICE_INTERFACE) if little else DEVICE_INTERFACE,
            activity=self._activity,
            blocks=blocks,
            little=little,
        )
        return await self.ask(asked)

    async def ask(self, call: Rpc) -> Rpc:
        self.send(Datagram(source=OWN, destination=DEVICE, data=call.encoded()).encoded(), ethertype=IPV4)
        return await self.rpc(lambda one: one.kind != Kind.REQUEST)

    async def rpc(self, wanted: Callable[[Rpc], bool]) -> Rpc:
        found = await self.frame(lambda frame: frame.ethertype == IPV4 and wanted(self._rpc(frame)))
        return self._rpc(found)

    def _rpc(self, frame: Frame) -> Rpc:
        return Rpc.parse(Datagram.parse(frame.payload).data)

    async def supervise(self, *, little: bool = False) -> Rpc:
        """Make a relation for records alone."""
        relation = Relation(type=SUPERVISOR, identifier=self.relation, mac=self.mac)
        return await self.call(CONNECT, relation.encoded(), little=little)

    async def control_device(
        self, *, modules: tuple[Module, ...] = MODULES, ratio: int = 32, watchdog: int = 100
    ) -> Rpc:
        """Make a relation with cyclic data, up to its first inputs; return the answer to the Connect."""
        relation = Relation(type=CONTROLLER, identifier=self.relation, mac=self.mac).encoded()
        inputs = CyclicData(type=INPUTS, reference=1, frame_id=0xC001, length=40, ratio=ratio, watchdog=watchdog,
                            data={(1, 1): 0}, consumed={(2, 1): 9})  # fmt: skip
        outputs = CyclicData(type=OUTPUTS, reference=2, frame_id=0xFFFF, length=40, ratio=ratio, watchdog=watchdog,
                             data={(2, 1): 0}, consumed={(1, 1): 9})  # fmt: skip
        blocks = relation + inputs.encoded() + outputs.encoded() + b"".join(one.encoded() for one in modules)
        answer = await self.call(CONNECT, blocks)
        if not answer.status:
            ended = Control(type=PARAMETERS_END, relation=self.relation, key=1, command=1)
            await self.call(CONTROL, ended.encoded())
        return answer

    def drive(self, outputs: bytes, *, good: bool = True, frame_id: int = 0xC101) -> None:
        """Send a frame with outputs of slot 2."""
        data = outputs + bytes([GOOD if good else 0, GOOD])
        self.send(RtFrame(frame_id=frame_id, data=data, counter=0).encoded())

    async def inputs(self) -> RtFrame:
        """Return the next frame with inputs."""
        found = await self.frame(lambda frame: frame.ethertype == PROFINET and frame.payload[0] == 0xC0)
        return RtFrame.parse(found.payload)

    async def read(self, slot: int, index: int, *, again: bool = False) -> tuple[int, bytes]:
        """Read a record, and return the status and the content."""
        asked = Record(writes=False, relation=bytes(16), slot=slot, subslot=1, index=index, length=4096)
        answer = await self.call(READ_IMPLICIT, asked.encoded(), again=again)
        return answer.status, blocks_of(answer.blocks)[1]

    async def write(self, slot: int, index: int, content: bytes, *, again: bool = False) -> int:
        """Write a record, and return the status."""
        asked = Record(writes=True, relation=self.relation, slot=slot, subslot=1, index=index, length=len(content))
        return (await self.call(WRITE, asked.encoded() + content, again=again)).status

    async def release(self) -> int:
        control = Control(type=RELEASED, relation=self.relation, key=1, command=4)
        return (await self.call(RELEASE, control.encoded())).status

    async def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        await self._process.wait()
