"""Honest EtherCAT adapters."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from pytest_otmcp.reference_adapters.core import AdapterError, AdapterServer, Call
from pytest_otmcp.reference_adapters.defects.defect import Handler, wrap
from pytest_otmcp.reference_adapters.ethercat import segment as segment_module
from pytest_otmcp.reference_adapters.ethercat import tools as tools_module
from pytest_otmcp.reference_adapters.ethercat.segment import Segment
from pytest_otmcp.reference_adapters.ethercat.tools import Tools

from .choice import again_after_silence, background_call, choices, in_background

__all__ = ["CHOICES"]

CHOICES, choice = choices("ethercat")

TERMINAL, DRIVE = 0, 1
READS = ("read_sdo", "read_pdo", "read_slave_by_alias", "get_slave_info")
_WORKER = Path(__file__).with_name("ethercat_worker.py")
_CYCLE, _WATCHDOG = 2, 3


def tools_of(server: AdapterServer) -> Tools:
    tools: Tools = server._tools["ping"].handler.__self__
    return tools


def segment_of(server: AdapterServer) -> Segment:
    return tools_of(server)._segment


def another_worker(segment: Segment, kind: str) -> None:
    segment._words[:0] = [kind, str(segment_module._WORKER)]
    segment_module._WORKER = _WORKER


# -- the line ---------------------------------------------------------------------------------------------------------


@choice("exchanges process data every 5 ms, with a watchdog of 0.2 s", "cycle and watchdog are the master's to say")
def short_cycle(server: AdapterServer) -> None:
    times(server, 0.005, 0.2)


@choice("exchanges process data every 0.25 s, with a watchdog of 4 s", "cycle and watchdog are the master's to say")
def slow_cycle(server: AdapterServer) -> None:
    times(server, 0.25, 4.0)


def times(server: AdapterServer, cycle_s: float, watchdog_s: float) -> None:
    segment = segment_of(server)
    segment.cycle_s, segment.watchdog_s = cycle_s, watchdog_s
    segment._words[_CYCLE], segment._words[_WATCHDOG] = str(cycle_s), str(watchdog_s)


@choice(
    "takes the slaves to SAFEOP when it ends, and does not leave that to their watchdogs",
    "outputs fall with their master, one way or another",
)
def ends_with_a_farewell(server: AdapterServer) -> None:
    segment = segment_of(server)
    another_worker(segment, "farewell")

    async def close() -> None:
        if segment._process is not None and segment._process.returncode is None:
            await segment._request("close", {})
        await segment.close()

    server._close = close


@choice(
    "takes both slaves to OP at its first call, where writes are enabled",
    "outputs are 0 in OP as they are in SAFEOP, as long as nobody writes others",
)
def in_op_from_the_first_call(server: AdapterServer) -> None:
    segment, begun = segment_of(server), False
    genuine = segment.ask

    async def ask(call: Call, op: str, **members: Any) -> Any:
        nonlocal begun
        found = await genuine(call, op, **members)
        if server.writes_enabled and not begun:
            begun = True
            for position in (TERMINAL, DRIVE):
                await genuine(background_call(server), "set_state", position=position, state="OP")
        return found

    segment.ask = ask


# -- reading ----------------------------------------------------------------------------------------------------------


@choice(
    "exchanges process data to read inputs, and does not read them out of the slave's memory",
    "a slave in SAFEOP sends inputs, and takes no outputs",
)
def inputs_by_process_data(server: AdapterServer) -> None:
    another_worker(segment_of(server), "inputs")


@choice("reads every object twice and answers the second result", "a read may be repeated")
def reads_objects_twice(server: AdapterServer) -> None:
    segment = segment_of(server)
    another_worker(segment, "twice")
    genuine = segment._attempt

    async def attempt(call: Call, op: str, changes: bool, members: dict[str, Any]) -> Any:
        found = await genuine(call, op, changes, members)
        if op == "upload":
            call.sending(changes_state=False)
            call.answered()
        return found

    segment._attempt = attempt


@choice(
    "waits half as long and reads a second time when the slave was silent",
    "requirement TMO-002: a read may be repeated; meta.attempts says so",
)
def reads_again_after_silence(server: AdapterServer) -> None:
    segment = segment_of(server)
    segment.timeout_s /= 2
    segment._words[1] = str(segment.timeout_s)
    again_after_silence(server, *READS)


@choice("ends a text at its first zero byte", "CiA 301: a VISIBLE_STRING may have zeros, which fill it up")
def texts_end_at_zero(server: AdapterServer) -> None:
    whole = tools_module.decode

    def decode(content: bytes, kind: Any) -> Any:
        return whole(content.partition(b"\0")[0] if kind == "STRING" else content, kind)

    tools_module.decode = decode


@choice("reads an object of the drive five times a second", "a master may read at any time")
def polls_an_object(server: AdapterServer) -> None:
    segment = segment_of(server)

    async def poll() -> None:
        await asyncio.sleep(0.2)
        await segment.ask(background_call(server), "upload", position=DRIVE, index=0x2001, subindex=3)

    in_background(server, poll)


@choice("reads the device type of the first slave as a ping", "any answer of a slave is one")
def ping_by_an_object(server: AdapterServer) -> None:
    segment = segment_of(server)

    async def ping(call: Call, arguments: Any) -> dict[str, Any]:
        await segment.ask(call, "upload", position=TERMINAL, index=0x1000, subindex=0)
        return {"reachable": True, "slave_position": TERMINAL, "state": "SAFEOP"}

    wrap(server, "ping", lambda genuine: ping)


# -- writing ----------------------------------------------------------------------------------------------------------


@choice(
    "believes the slave's answer to a download, and does not read the object back",
    "the slave has said that it has taken the value",
)
def believes_the_answer(server: AdapterServer) -> None:
    segment, tools = segment_of(server), tools_of(server)

    async def download(call: Call, place: Any, kind: str, value: object, content: bytes) -> bytes:
        number = value if isinstance(value, int | float) and not isinstance(value, bool) else None
        call.changes((f"{place.slave_position}:{place.index:04x}:{place.subindex}", number))
        where = {"position": place.slave_position, "index": place.index, "subindex": place.subindex}
        await segment.ask(call, "download", changes=True, data=content.hex(), **where)
        return content

    tools._download = download


@choice(
    "knows from its device description which objects can be written, and their bounds, and sends nothing else",
    "a refusal for which nothing was sent is as good as the slave's",
)
def refuses_by_its_description(server: AdapterServer) -> None:
    def looked(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Any:
            place = arguments.slave_position, arguments.index, arguments.subindex
            if place == (DRIVE, 0x1000, 0):
                raise AdapterError("not_writable", "the object can only be read", outcome="not_sent")
            value = arguments.value
            if place == (DRIVE, 0x2000, 1) and isinstance(value, int | float) and not 0 <= value <= 1000:
                message = "the object takes 0 to 1000"
                raise AdapterError("range_overflow", message, field="/value", outcome="not_sent")
            return await genuine(call, arguments)

        return handler

    wrap(server, "write_sdo", looked)
