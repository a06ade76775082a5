"""Defects that the checks of the area WR notice."""

from __future__ import annotations

import asyncio
import difflib
from functools import partial
from typing import Any

from ...core import AdapterError, AdapterServer, Call
from ...modbus import link as modbus_link
from ..any_protocol import enabled_by_any_word, enabled_by_default, guard_after_sending
from ..bacnet import told_as_asked
from ..defect import Change, Data, Defect, Handler, around, defect, succeeding, tools_of, wrap
from ..modbus import write_not_sent, write_only_remembered
from ..mqtt import made_up_for

__all__ = ["DEFECTS"]

_WRITE, _BLOCK, _MASK, _COIL = "write_register", "write_registers", "mask_write_register", "write_coil"


def _coil_as_asked(call: Call, arguments: Any) -> Data:
    return {"address": arguments.address, "value": arguments.value}


@around(_COIL)
async def coil_always_on(genuine: Handler, call: Call, arguments: Any) -> Data:
    await genuine(call, arguments.model_copy(update={"value": True}))
    return _coil_as_asked(call, arguments)


@around(_COIL)
async def coil_of_the_lowest(genuine: Handler, call: Call, arguments: Any) -> Data:
    await genuine(call, arguments.model_copy(update={"address": arguments.address % 64}))
    return _coil_as_asked(call, arguments)


@around(_COIL)
async def coil_not_sent(genuine: Handler, call: Call, arguments: Any) -> Data:
    return {"address": arguments.address, "value": arguments.value}


@around("write_opcua_node")
async def node_not_written(genuine: Handler, call: Call, arguments: Any) -> Data:
    return {"node_id": arguments.node_id, "value": arguments.value, "data_type": "Double", "status": "Good"}


_KNOWN = ["ns=2;s=ValvePosition", "ns=2;s=FanSpeed", "ns=2;s=HeaterPower", "ns=2;s=PumpEnabled"]


@around("write_opcua_node")
async def the_nearest_name(genuine: Handler, call: Call, arguments: Any) -> Data:
    try:
        return await genuine(call, arguments)
    except AdapterError as error:
        found = difflib.get_close_matches(arguments.node_id, _KNOWN, 1)
        if error.code != "illegal_address" or not found:
            raise
        data = await genuine(call, arguments.model_copy(update={"node_id": found[0]}))
        return {**data, "node_id": arguments.node_id}


def equal_to_the_last(server: AdapterServer) -> None:
    written: dict[str, Data] = {}

    @around("write_opcua_node")
    async def only_what_differs(genuine: Handler, call: Call, arguments: Any) -> Data:
        before = written.get(arguments.node_id)
        if before is None or before["value"] != arguments.value:
            written[arguments.node_id] = await genuine(call, arguments)
        return written[arguments.node_id]

    only_what_differs(server)


def written_as_before(server: AdapterServer) -> None:
    """Leave out a write of the value that a register was written with, once another register was written in between."""
    written: dict[int, Data] = {}
    last: list[int] = []

    @around(_WRITE)
    async def only_what_differs(genuine: Handler, call: Call, arguments: Any) -> Data:
        at, before = arguments.address, written.get(arguments.address)
        if before is None or before["value"] != arguments.value or last == [at]:
            before = await genuine(call, arguments)
        written[at], last[:] = before, [at]
        return before

    only_what_differs(server)


@around(_BLOCK)
async def next_block(genuine: Handler, call: Call, arguments: Any) -> Data:
    data = await genuine(call, arguments.model_copy(update={"address": arguments.address + 1}))
    return {**data, "address": arguments.address}


@around(_WRITE)
async def always_unit_1(genuine: Handler, call: Call, arguments: Any) -> Data:
    data = await genuine(call, arguments.model_copy(update={"unit_id": 1}))
    return data


def sent_again(*codes: str, names: tuple[str, ...]) -> Change:
    """Return the defect that these tools send a write again after a failure with one of these codes."""

    @around(*names)
    async def again(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            data = await genuine(call, arguments)
        except AdapterError as error:
            if error.code not in codes:
                raise
            data = await genuine(call, arguments)
        return data

    return again


def impatient_and_sent_again(server: AdapterServer) -> None:
    """Send a write again when its answer is late. The second try has the usual time: a busy machine must not let it fail, too."""
    link = tools_of(server, _WRITE)._link
    usual = link._timeout_s

    @around(_WRITE)
    async def again(genuine: Handler, call: Call, arguments: Any) -> Data:
        link._timeout_s = 0.1
        try:
            data = await genuine(call, arguments)
        except AdapterError as error:
            if error.code != "timeout":
                raise
        else:
            return data
        finally:
            link._timeout_s = usual
        data = await genuine(call, arguments)
        return data

    again(server)


def unguarded(*names: str) -> Change:
    """Return the defect that the guard has forgotten these tools."""

    def apply(server: AdapterServer) -> None:
        for name in () if server.writes_enabled else names:
            wrap(server, name, lambda genuine: genuine, writes=False)

    return apply


def denied_after_sending(server: AdapterServer) -> None:
    if not server.writes_enabled:
        guard_after_sending(_WRITE)(server)


def split_blocks(server: AdapterServer) -> None:
    """Take blocks of any length, and write them in parts."""
    tools = tools_of(server, _BLOCK)
    anything = _without_bounds(server, _BLOCK)

    @around(_BLOCK, model=anything)
    async def parted(genuine: Handler, call: Call, arguments: Any) -> Data:
        values = arguments.values
        for first in range(0, len(values), 100):
            await tools._write_block(call, arguments, arguments.address + first, values[first : first + 100])
        return {"address": arguments.address, "count": len(values), "values": values}

    parted(server)


def _without_bounds(server: AdapterServer, name: str) -> Any:
    genuine = server._tools[name].model
    return type("Anything", (genuine,), {"__annotations__": {"values": list[int]}, "__module__": __name__})


def too_long_a_block(server: AdapterServer) -> None:
    """Send the device a block that is longer than a request may be."""
    tools = tools_of(server, _BLOCK)

    @around(_BLOCK, model=_without_bounds(server, _BLOCK))
    async def whole(genuine: Handler, call: Call, arguments: Any) -> Data:
        values = arguments.values
        await tools._write_block(call, arguments, arguments.address, values[:123])
        return {"address": arguments.address, "count": len(values), "values": values}

    whole(server)


def any_echo(server: AdapterServer) -> None:
    """Take every answer of the function for a confirmation."""
    genuine = modbus_link.reply_pdu

    def lenient(request: Any, received: bytes) -> bytes:
        if request.pdu[0] in (5, 6, 15, 16, 22):
            return received[7:]
        return genuine(request, received)

    modbus_link.reply_pdu = lenient


def any_value_echoed(server: AdapterServer) -> None:
    """Compare the address of a confirmation, and not its value."""
    genuine = modbus_link.reply_pdu

    def lenient(request: Any, received: bytes) -> bytes:
        if request.pdu[0] == 6 and received[7:10] == request.pdu[:3]:
            return received[7:]
        return genuine(request, received)

    modbus_link.reply_pdu = lenient


def written_later(
    server: AdapterServer,
    address: int | None = None,
    after_s: float = 0.0,
    kinds: tuple[str, ...] = ("connect_failed", "connection_lost"),
) -> None:
    """Keep the writes that failed for want of a connection, and send them with the next read or so many seconds after it, to this address
    or to their own."""
    tools = tools_of(server, _WRITE)
    kept: list[Any] = []
    under_way: set[asyncio.Task[Any]] = set()

    def send(call: Call, late: Any) -> None:
        under_way.add(asyncio.ensure_future(tools.write_register(call, late)))

    @around(_WRITE)
    async def keeping(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            data = await genuine(call, arguments)
        except AdapterError as error:
            if error.code in kinds:
                kept.append(arguments)
            raise
        return data

    @around("read_multiple_holding_registers")
    async def making_up(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments)
        while kept:
            late = kept.pop()
            late = late if address is None else late.model_copy(update={"address": address})
            if after_s:
                asyncio.get_running_loop().call_later(after_s, send, call, late)
            else:
                await tools.write_register(call, late)
        return data

    keeping(server)
    making_up(server)


def unheeded(by: str, count: int) -> Change:
    """Return the defect that every register that was written is read back by a tool, so many at once, and nobody looks at what that says."""

    def apply(server: AdapterServer) -> None:
        reading = server._tools[by]

        @around(_WRITE)
        async def reading_back(genuine: Handler, call: Call, arguments: Any) -> Data:
            data = await genuine(call, arguments)
            await reading.handler(call, reading.model(address=arguments.address, count=count))
            return data

        reading_back(server)

    return apply


def emulated_mask_write(server: AdapterServer) -> None:
    tools = tools_of(server, _MASK)

    @around(_MASK)
    async def emulated(genuine: Handler, call: Call, arguments: Any) -> Data:
        (old,) = await tools._holding(call, arguments, arguments.address, 1)
        and_mask, or_mask = arguments.and_mask, arguments.or_mask
        await tools._write_block(
            call, arguments, arguments.address, [(old & and_mask) | (or_mask & ~and_mask & 0xFFFF)]
        )
        return {"address": arguments.address, "and_mask": and_mask, "or_mask": or_mask}

    emulated(server)


@around(_MASK)
async def masks_exchanged(genuine: Handler, call: Call, arguments: Any) -> Data:
    asked = {"and_mask": arguments.and_mask, "or_mask": arguments.or_mask}
    swapped = {"and_mask": arguments.or_mask, "or_mask": arguments.and_mask}
    data = await genuine(call, arguments.model_copy(update=swapped))
    return {**data, **asked}


@around("write_opcua_node")
async def clamping_ignored(genuine: Handler, call: Call, arguments: Any) -> Data:
    data = await genuine(call, arguments)
    return {**{name: value for name, value in data.items() if name != "clamped"}, "value": arguments.value}


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-02w",
        "modbus",
        "Blocks are written one register further.",
        next_block,
        "WR-001 WR-002 WR-006 WR-007 WR-008",
        "WR-001 WR-002 WR-006 WR-007",
    ),
    defect(
        "MU-05w",
        "modbus",
        "Whatever unit is asked for, it is unit 1.",
        always_unit_1,
        "WR-002 WR-006",
        "WR-001 WR-002 WR-006",
    ),
    defect(
        "MU-14w",
        "modbus",
        "A write succeeds, and nothing is sent.",
        write_not_sent,
        "WR-001 WR-002 WR-003 WR-004 WR-005 WR-006 WR-007 WR-009 WR-010 WR-012",
        "WR-001 WR-006 WR-007 WR-009",
    ),
    defect(
        "MU-14c",
        "modbus",
        "A coil is told as switched, and nothing is sent.",
        coil_not_sent,
        "WR-001 WR-002 WR-004 WR-006 WR-009 WR-010",
        "WR-001 WR-006 WR-009",
    ),
    defect("MU-14d", "modbus", "A coil is switched on, whatever is asked for.", coil_always_on, "WR-001"),
    defect("MU-06c", "modbus", "Of a coil's address the last six bits count.", coil_of_the_lowest, "WR-001"),
    defect(
        "MU-14e",
        "modbus",
        "A coil that the device refuses is told as switched.",
        succeeding(_COIL, code="illegal_address", answer=_coil_as_asked),
        "ERR-002",
    ),
    defect(
        "MU-25d",
        "modbus",
        "A coil whose write has no answer is switched again.",
        sent_again("timeout", "connection_lost", names=(_COIL,)),
        "WR-003",
    ),
    defect(
        "MU-14o",
        "opcua",
        "A Write succeeds, and nothing is sent.",
        node_not_written,
        "WR-001 WR-002 WR-003 WR-004 WR-005 WR-006 WR-007 WR-010",
        "OUA-001 WR-001 WR-006 WR-007 WR-012",
    ),
    defect(
        "MU-14y",
        "opcua",
        "A write to a node that does not exist goes to one that is called nearly like it.",
        the_nearest_name,
        "WR-001",
        "WR-001 WR-002",
    ),
    defect(
        "MU-14z",
        "opcua",
        "A write of the value that was written last is told as done, and not sent.",
        equal_to_the_last,
        "WR-001 WR-004",
        "WR-001",
    ),
    defect(
        "MU-14m",
        "modbus",
        "A register is told as written with the value that it was written with before, and nothing is sent, once another one was written in between.",
        written_as_before,
        "WR-001",
    ),
    defect(
        "MU-15w",
        "modbus",
        "A write succeeds, nothing is sent, and it is read back from memory.",
        write_only_remembered,
        "WR-001 WR-002 WR-003 WR-004 WR-005 WR-006 WR-007 WR-009 WR-010 WR-012",
        "WR-001 WR-006 WR-007 WR-009",
    ),
    defect("MU-16", "modbus", "The device confirms anything, and nobody minds.", any_echo, "WR-009"),
    defect(
        "MU-16v",
        "modbus",
        "The device confirms another value than the one that was written, and nobody minds.",
        any_value_echoed,
        "WR-009",
    ),
    defect(
        "MU-17", "opcua", "The server cuts a value off and says so, and nobody is told.", clamping_ignored, "", "WR-012"
    ),
    defect("MU-18", "modbus", "With writes disabled a mask write is sent.", unguarded(_MASK), "WR-004"),
    defect(
        "MU-18c", "modbus", "With writes disabled coils are switched.", unguarded(_COIL, "write_coils_bulk"), "WR-004"
    ),
    defect("MU-18t", "modbus", "With writes disabled a tag is written.", unguarded("write_tag"), "WR-004"),
    defect("MU-19w", "opcua", "With writes disabled a method is called.", unguarded("call_opcua_method"), "WR-004"),
    defect(
        "MU-79w",
        "mqtt",
        "With writes disabled commands to devices are sent.",
        unguarded("publish_device_command"),
        "WR-004",
    ),
    defect(
        "MU-20w",
        "modbus",
        "With writes disabled the write is sent, and then denied.",
        denied_after_sending,
        "WR-004 WR-005",
    ),
    defect(
        "MU-21w",
        "modbus",
        "Writes are enabled unless they are switched off.",
        enabled_by_default("MODBUS_WRITES_ENABLED"),
        "WR-004 WR-005",
        "WR-004",
    ),
    defect("MU-21c", "modbus", "Any word in the write switch enables writes.", enabled_by_any_word, "WR-005"),
    defect(
        "MU-25",
        "modbus",
        "A write without an answer is sent again.",
        sent_again("timeout", "connection_lost", names=(_WRITE,)),
        "WR-003",
    ),
    defect("MU-25l", "modbus", "A write whose answer is late is sent again.", impatient_and_sent_again, "WR-003"),
    defect(
        "MU-25o",
        "opcua",
        "A Write without an answer is sent again.",
        sent_again("timeout", "connection_lost", names=("write_opcua_node",)),
        "WR-003",
    ),
    defect(
        "MU-25q",
        "mqtt",
        "A publish without an acknowledgement is sent again as a new message.",
        sent_again("timeout", "connection_lost", names=("publish_message",)),
        "WR-003",
    ),
    defect("MU-27", "modbus", "A long block is written in parts.", split_blocks, "WR-008", "ERR-006 WR-008"),
    defect(
        "MU-27c",
        "modbus",
        "Of a block that is too long a part is written.",
        too_long_a_block,
        "WR-008",
        "ERR-006 WR-008",
    ),
    defect(
        "MU-28x",
        "modbus",
        "Of a mask write the two masks are exchanged, and told as asked for.",
        masks_exchanged,
        "WR-001 WR-002 WR-011",
        "WR-001 WR-011",
    ),
    defect("MU-28", "modbus", "A mask write is a read and a write.", emulated_mask_write, "WR-011"),
    defect(
        "MU-29m",
        "modbus",
        "A register write that failed is made up for after the outage.",
        written_later,
        "WR-003 WR-010",
    ),
    defect("MU-29q", "mqtt", "A publish that failed is made up for after the outage.", made_up_for, "WR-003 WR-010"),
    defect(
        "MU-17m",
        "modbus",
        "A register is read back after a write, and nobody looks at it.",
        unheeded("read_multiple_holding_registers", 1),
        "",
        "WR-012",
    ),
    defect(
        "MU-17mb",
        "modbus",
        "A block is read back after a write of its first register, and nobody looks at it.",
        unheeded("read_multiple_holding_registers", 10),
        "",
        "WR-012",
    ),
    defect(
        "MU-17bac",
        "bacnet",
        "A property that is read back after a write, and holds something else, is told as written.",
        succeeding("write_property", code="verify_failed", answer=told_as_asked),
        "",
        "WR-012",
    ),
    defect(
        "MU-29ml",
        "modbus",
        "A register write that failed is carried out at another register, two seconds after the outage.",
        partial(written_later, address=60, after_s=2.0, kinds=("connect_failed",)),
        "WR-010",
    ),
    defect(
        "MU-29qt",
        "mqtt",
        "A publish that failed is published on another topic after the outage.",
        partial(made_up_for, topic="line/late"),
        "WR-010",
    ),
    defect(
        "MU-29ql",
        "mqtt",
        "A publish that failed is published on another topic, two seconds after the outage.",
        partial(made_up_for, topic="line/late", after_s=2.0),
        "WR-010",
    ),
)
