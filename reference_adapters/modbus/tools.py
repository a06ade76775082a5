"""The seventeen Modbus tools. Addresses are those of the PDU, from 0."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.pdu import ModbusPDU

from ..core import AdapterError, Call, NameMap, Nothing, device_text, tool
from .codec import decode, encode, width
from .link import Link
from .shapes import (
    MAX_READ_REGISTERS,
    Bits,
    BitStates,
    Cell,
    CoilState,
    Identification,
    Masked,
    MaskWrite,
    Reachable,
    Registers,
    RegisterValue,
    RegisterValues,
    TagList,
    TagName,
    TagValue,
    TagWritten,
    Typed,
    TypedValue,
    Unit,
    WriteCoil,
    WriteCoils,
    WriteRegister,
    WriteRegisters,
    WriteTag,
)
from .tags import Tag, engineering_value, raw_value

__all__ = ["Tools"]

Send = Callable[[AsyncModbusTcpClient, int], Awaitable[ModbusPDU]]
Read = Callable[[Call, Unit, int, int], Awaitable[list[int]]]

REGULAR_IDENTIFICATION = 2
MORE_FOLLOWS = 0xFF


class Tools:
    """The tools over one connection.

    Args:
        link: the connection.
        default_unit: the unit identifier of calls that name none.
        tags: the tag map.
    """

    def __init__(self, link: Link, *, default_unit: int, tags: Mapping[str, Tag]) -> None:
        self._link = link
        self._default_unit = default_unit
        self._tags = NameMap(tags, kind="tag", argument="tag", listed_by="list_tags")

    # -- reading ------------------------------------------------------------------------------------------

    @tool("modbus.ping")
    async def ping(self, call: Call, arguments: Unit) -> Reachable:
        """Confirm that the device answers: reads holding register 0 and accepts any well-formed reply."""
        try:
            await self._holding(call, arguments, 0, 1)
        except AdapterError as error:
            # An exception reply is an answer, too: the device is there. A gateway's exception is not the device's.
            if "exception_code" not in call.trace or error.code.startswith("gateway"):
                raise
        return {"reachable": True}

    @tool("modbus.read_holding")
    async def read_register(self, call: Call, arguments: Cell) -> RegisterValue:
        """Read one holding register (function 03)."""
        (value,) = await self._holding(call, arguments, arguments.address, 1)
        return {"address": arguments.address, "value": value}

    @tool("modbus.read_holding")
    async def read_multiple_holding_registers(self, call: Call, arguments: Registers) -> RegisterValues:
        """Read up to 2000 holding registers (function 03), 125 by each request."""
        values = await _in_blocks(self._holding, call, arguments)
        return {"address": arguments.address, "count": arguments.count, "values": values}

    @tool("modbus.read_input")
    async def read_input_registers(self, call: Call, arguments: Registers) -> RegisterValues:
        """Read up to 2000 input registers (function 04), 125 by each request."""
        values = await _in_blocks(self._inputs, call, arguments)
        return {"address": arguments.address, "count": arguments.count, "values": values}

    @tool("modbus.read_coils")
    async def read_coils(self, call: Call, arguments: Bits) -> BitStates:
        """Read up to 2000 coils (function 01)."""
        address, count = arguments.address, arguments.count
        reply = await self._exchange(
            call, arguments, lambda client, unit: client.read_coils(address, count=count, device_id=unit)
        )
        return _bit_states(arguments, reply)

    @tool("modbus.read_discrete")
    async def read_discrete_inputs(self, call: Call, arguments: Bits) -> BitStates:
        """Read up to 2000 discrete inputs (function 02)."""
        address, count = arguments.address, arguments.count
        reply = await self._exchange(
            call, arguments, lambda client, unit: client.read_discrete_inputs(address, count=count, device_id=unit)
        )
        return _bit_states(arguments, reply)

    @tool("modbus.read_typed")
    async def read_holding_typed(self, call: Call, arguments: Typed) -> TypedValue:
        """Read a number that spans holding registers, in one request."""
        block = await self._holding(call, arguments, arguments.address, width(arguments.data_type))
        return {"address": arguments.address, **decode(block, arguments.data_type, arguments.order)}

    @tool("modbus.read_typed")
    async def read_input_typed(self, call: Call, arguments: Typed) -> TypedValue:
        """Read a number that spans input registers, in one request."""
        block = await self._inputs(call, arguments, arguments.address, width(arguments.data_type))
        return {"address": arguments.address, **decode(block, arguments.data_type, arguments.order)}

    @tool("modbus.identify")
    async def read_device_information(self, call: Call, arguments: Unit) -> Identification:
        """Read the device's identification (function 2B/0E, regular objects): texts that the device supplies."""
        objects: dict[str, str] = {}
        following = 0
        while True:
            first = following
            reply = await self._identification(call, arguments, first)
            for number, text in sorted(getattr(reply, "information", {}).items()):
                objects[str(number)] = device_text(call, f"/data/objects/{number}", text)
            following = int(getattr(reply, "next_object_id", 0))
            # Without this check, a device whose next object lies before the last one would be asked for ever.
            if getattr(reply, "more_follows", 0) != MORE_FOLLOWS or following <= first:
                return {"objects": objects}

    @tool("modbus.list_tags")
    async def list_tags(self, call: Call, arguments: Nothing) -> TagList:
        """List the tag map: names, places, types and units. Asks the device nothing."""
        return {"tags": [{"tag": name, **tag.model_dump()} for name, tag in sorted(self._tags.items())]}

    @tool("modbus.read_tag")
    async def read_tag(self, call: Call, arguments: TagName) -> TagValue:
        """Read a tag's engineering value."""
        tag = self._tags.known(arguments.tag)
        read = self._inputs if tag.table == "input" else self._holding
        reading = decode(await read(call, Unit(), tag.address, width(tag.type)), tag.type, tag.order)
        reading["value"] = engineering_value(tag, reading["value"])
        return {"tag": arguments.tag, "unit": tag.unit, **reading}

    # -- writing ------------------------------------------------------------------------------------------

    @tool("modbus.write_holding", writes=True)
    async def write_register(self, call: Call, arguments: WriteRegister) -> RegisterValue:
        """Write one holding register (function 06)."""
        address, value = arguments.address, arguments.value
        self._changes(call, arguments, "holding_registers", address, [value])
        await self._exchange(
            call, arguments, lambda client, unit: client.write_register(address, value, device_id=unit)
        )
        return {"address": address, "value": value}

    @tool("modbus.write_holding", writes=True)
    async def write_registers(self, call: Call, arguments: WriteRegisters) -> RegisterValues:
        """Write up to 123 holding registers in one request (function 16)."""
        await self._write_block(call, arguments, arguments.address, arguments.values)
        return {"address": arguments.address, "count": len(arguments.values), "values": arguments.values}

    @tool("modbus.write_coil", writes=True)
    async def write_coil(self, call: Call, arguments: WriteCoil) -> CoilState:
        """Switch one coil (function 05)."""
        address, value = arguments.address, arguments.value
        self._changes(call, arguments, "coils", address, [value])
        await self._exchange(call, arguments, lambda client, unit: client.write_coil(address, value, device_id=unit))
        return {"address": address, "value": value}

    @tool("modbus.write_coil", writes=True)
    async def write_coils_bulk(self, call: Call, arguments: WriteCoils) -> BitStates:
        """Switch up to 1968 coils in one request (function 15)."""
        address, values = arguments.address, arguments.values
        self._changes(call, arguments, "coils", address, values)
        await self._exchange(call, arguments, lambda client, unit: client.write_coils(address, values, device_id=unit))
        return {"address": address, "count": len(values), "values": values}

    @tool("modbus.mask_write", writes=True)
    async def mask_write_register(self, call: Call, arguments: MaskWrite) -> Masked:
        """Change single bits of a holding register atomically in the device (function 22):
        new value = (old AND and_mask) OR (or_mask AND NOT and_mask)."""
        address, and_mask, or_mask = arguments.address, arguments.and_mask, arguments.or_mask
        # The value that it makes is known to the device alone.
        self._changes(call, arguments, "holding_registers", address, [None])
        await self._exchange(
            call,
            arguments,
            lambda client, unit: client.mask_write_register(
                address=address, and_mask=and_mask, or_mask=or_mask, device_id=unit
            ),
        )
        return {"address": address, "and_mask": and_mask, "or_mask": or_mask}

    @tool("modbus.write_tag", writes=True)
    async def write_tag(self, call: Call, arguments: WriteTag) -> TagWritten:
        """Write a tag's engineering value, rounded to the nearest raw value."""
        tag = self._tags.writable(arguments.tag)
        raw = raw_value(tag, arguments.value)
        await self._write_block(call, Unit(), tag.address, encode(raw, tag.type, tag.order))
        return {"tag": arguments.tag, "value": arguments.value, "raw": raw, "unit": tag.unit}

    async def present(self, call: Call, target: str) -> int | bool:
        """Return what a target of :meth:`Call.changes` holds."""
        unit, table, address = target.split("/")
        if table == "coils":
            coil = Bits(unit_id=int(unit), address=int(address), count=1)
            return (await self.read_coils(call, coil))["values"][0]
        return (await self.read_register(call, Cell(unit_id=int(unit), address=int(address))))["value"]

    # -- requests -----------------------------------------------------------------------------------------

    async def _exchange(self, call: Call, arguments: Unit, send: Send) -> ModbusPDU:
        unit = self._default_unit if arguments.unit_id is None else arguments.unit_id
        return await self._link.exchange(call, lambda client: send(client, unit))

    async def _holding(self, call: Call, arguments: Unit, address: int, count: int) -> list[int]:
        reply = await self._exchange(
            call, arguments, lambda client, unit: client.read_holding_registers(address, count=count, device_id=unit)
        )
        return list(reply.registers)

    async def _inputs(self, call: Call, arguments: Unit, address: int, count: int) -> list[int]:
        reply = await self._exchange(
            call, arguments, lambda client, unit: client.read_input_registers(address, count=count, device_id=unit)
        )
        return list(reply.registers)

    async def _identification(self, call: Call, arguments: Unit, first: int) -> ModbusPDU:
        return await self._exchange(
            call,
            arguments,
            lambda client, unit: client.read_device_information(
                read_code=REGULAR_IDENTIFICATION, object_id=first, device_id=unit
            ),
        )

    def targets(self, arguments: Unit, table: str, address: int, values: Sequence[object]) -> list[tuple[str, object]]:
        """Return what a write of these values changes, as :meth:`Call.changes` takes it."""
        unit = self._default_unit if arguments.unit_id is None else arguments.unit_id
        return [(f"{unit}/{table}/{address + index}", value) for index, value in enumerate(values)]

    def _changes(self, call: Call, arguments: Unit, table: str, address: int, values: Sequence[object]) -> None:
        call.changes(*self.targets(arguments, table, address, values))

    async def _write_block(self, call: Call, arguments: Unit, address: int, values: list[int]) -> None:
        self._changes(call, arguments, "holding_registers", address, values)
        await self._exchange(
            call, arguments, lambda client, unit: client.write_registers(address, values, device_id=unit)
        )


async def _in_blocks(read: Read, call: Call, arguments: Registers) -> list[int]:
    """Read a block by as few requests as the protocol allows."""
    if arguments.count > MAX_READ_REGISTERS:
        call.extra["atomic"] = False
    values: list[int] = []
    while missing := arguments.count - len(values):
        values += await read(call, arguments, arguments.address + len(values), min(missing, MAX_READ_REGISTERS))
    return values


def _bit_states(arguments: Bits, reply: ModbusPDU) -> BitStates:
    # The reply is padded to whole bytes; only the bits that were asked for are returned.
    values = [bool(bit) for bit in reply.bits[: arguments.count]]
    return {"address": arguments.address, "count": arguments.count, "values": values}
