"""The seventeen tools. Addresses are those of the PDU, from 0."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.pdu import ModbusPDU

from ..core import AdapterError, AdapterServer, Call, ConfigError, Environment, device_text
from .codec import decode, encode, width
from .link import Link
from .shapes import (
    Bits,
    BitStates,
    Cell,
    CoilState,
    Identification,
    Masked,
    MaskWrite,
    Nothing,
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
    is_unit,
)
from .tags import Tag, engineering_value, load_tags, raw_value

__all__ = ["build"]

REGULAR_IDENTIFICATION = 2
MORE_FOLLOWS = 0xFF


def build() -> AdapterServer:
    """The adapter as the environment configures it.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    host = environment.text("MODBUS_HOST", "127.0.0.1")
    port = environment.whole("MODBUS_PORT", 502, 1, 65535)
    default_unit = environment.whole("MODBUS_UNIT_ID", 1, 0, 255)
    if not is_unit(default_unit):
        raise ConfigError(f"MODBUS_UNIT_ID: expected 0 to 247 or 255, found {default_unit}")
    tags = load_tags(environment.optional("MODBUS_TAG_MAP"))
    link = Link(host, port, environment.seconds("MODBUS_TIMEOUT_S", 1.0))
    server = AdapterServer(
        name="modbus-reference",
        version="0.1.0",
        protocol="modbus-tcp",
        endpoint=f"modbus+tcp://{f'[{host}]' if ':' in host else host}:{port}",
        writes_enabled=environment.writes_enabled("MODBUS_WRITES_ENABLED"),
        switch="MODBUS_WRITES_ENABLED",
        deadline_s=environment.seconds("MODBUS_DEADLINE_S", 3.0),
        close=link.close,
    )

    async def exchange(
        call: Call, arguments: Unit, send: Callable[[AsyncModbusTcpClient, int], Awaitable[ModbusPDU]]
    ) -> ModbusPDU:
        unit = default_unit if arguments.unit_id is None else arguments.unit_id
        return await link.exchange(call, lambda client: send(client, unit))

    async def holding(call: Call, arguments: Unit, address: int, count: int) -> list[int]:
        reply = await exchange(
            call,
            arguments,
            lambda client, unit: client.read_holding_registers(address, count=count, device_id=unit),
        )
        return list(reply.registers)

    async def inputs(call: Call, arguments: Unit, address: int, count: int) -> list[int]:
        reply = await exchange(
            call,
            arguments,
            lambda client, unit: client.read_input_registers(address, count=count, device_id=unit),
        )
        return list(reply.registers)

    # -- reading --------------------------------------------------------------------------------------------

    @server.tool("modbus.ping")
    async def ping(call: Call, arguments: Unit) -> Reachable:
        """Confirm that the device answers: reads holding register 0 and accepts any well-formed reply."""
        try:
            await holding(call, arguments, 0, 1)
        except AdapterError as error:
            # An exception reply is an answer too: the device is there. A gateway's is not the device's.
            if "exception_code" not in call.trace or error.code.startswith("gateway"):
                raise
        return {"reachable": True}

    @server.tool("modbus.read_holding")
    async def read_register(call: Call, arguments: Cell) -> RegisterValue:
        """Read one holding register (function 03)."""
        (value,) = await holding(call, arguments, arguments.address, 1)
        return {"address": arguments.address, "value": value}

    @server.tool("modbus.read_holding")
    async def read_multiple_holding_registers(call: Call, arguments: Registers) -> RegisterValues:
        """Read up to 125 holding registers (function 03)."""
        values = await holding(call, arguments, arguments.address, arguments.count)
        return {"address": arguments.address, "count": arguments.count, "values": values}

    @server.tool("modbus.read_input")
    async def read_input_registers(call: Call, arguments: Registers) -> RegisterValues:
        """Read up to 125 input registers (function 04)."""
        values = await inputs(call, arguments, arguments.address, arguments.count)
        return {"address": arguments.address, "count": arguments.count, "values": values}

    @server.tool("modbus.read_coils")
    async def read_coils(call: Call, arguments: Bits) -> BitStates:
        """Read up to 2000 coils (function 01)."""
        reply = await exchange(
            call,
            arguments,
            lambda client, unit: client.read_coils(arguments.address, count=arguments.count, device_id=unit),
        )
        return _bit_states(arguments, reply)

    @server.tool("modbus.read_discrete")
    async def read_discrete_inputs(call: Call, arguments: Bits) -> BitStates:
        """Read up to 2000 discrete inputs (function 02)."""
        reply = await exchange(
            call,
            arguments,
            lambda client, unit: client.read_discrete_inputs(arguments.address, count=arguments.count, device_id=unit),
        )
        return _bit_states(arguments, reply)

    @server.tool("modbus.read_typed")
    async def read_holding_typed(call: Call, arguments: Typed) -> TypedValue:
        """Read a number that spans holding registers, in one request."""
        block = await holding(call, arguments, arguments.address, width(arguments.data_type))
        return {"address": arguments.address, **decode(block, arguments.data_type, arguments.order)}

    @server.tool("modbus.read_typed")
    async def read_input_typed(call: Call, arguments: Typed) -> TypedValue:
        """Read a number that spans input registers, in one request."""
        block = await inputs(call, arguments, arguments.address, width(arguments.data_type))
        return {"address": arguments.address, **decode(block, arguments.data_type, arguments.order)}

    @server.tool("modbus.identify")
    async def read_device_information(call: Call, arguments: Unit) -> Identification:
        """Read the device's identification (function 2B/0E, regular objects): texts that the device supplies."""
        objects: dict[str, str] = {}
        following = 0
        while True:
            reply = await exchange(
                call,
                arguments,
                lambda client, unit, first=following: client.read_device_information(  # type: ignore[misc]
                    read_code=REGULAR_IDENTIFICATION, object_id=first, device_id=unit
                ),
            )
            for number, text in sorted(getattr(reply, "information", {}).items()):
                objects[str(number)] = device_text(call, f"/data/objects/{number}", text)
            more, previous = getattr(reply, "more_follows", 0) == MORE_FOLLOWS, following
            following = int(getattr(reply, "next_object_id", 0))
            # A device that points backwards would be asked for ever.
            if not more or following <= previous:
                return {"objects": objects}

    @server.tool("modbus.list_tags")
    async def list_tags(call: Call, arguments: Nothing) -> TagList:
        """List the tag map: names, places, types and units. Asks the device nothing."""
        return {"tags": [{"tag": name, **tag.model_dump()} for name, tag in sorted(tags.items())]}

    @server.tool("modbus.read_tag")
    async def read_tag(call: Call, arguments: TagName) -> TagValue:
        """Read a tag's engineering value."""
        tag = known_tag(arguments.tag)
        read = inputs if tag.table == "input" else holding
        reading = decode(await read(call, Unit(), tag.address, width(tag.type)), tag.type, tag.order)
        reading["value"] = engineering_value(tag, reading["value"])
        return {"tag": arguments.tag, "unit": tag.unit, **reading}

    # -- writing --------------------------------------------------------------------------------------------

    async def put_registers(call: Call, arguments: Unit, address: int, values: list[int]) -> None:
        await exchange(
            call,
            arguments,
            lambda client, unit: client.write_registers(address, values, device_id=unit),
        )

    @server.tool("modbus.write_holding", writes=True)
    async def write_register(call: Call, arguments: WriteRegister) -> RegisterValue:
        """Write one holding register (function 06)."""
        await exchange(
            call,
            arguments,
            lambda client, unit: client.write_register(arguments.address, arguments.value, device_id=unit),
        )
        return {"address": arguments.address, "value": arguments.value}

    @server.tool("modbus.write_holding", writes=True)
    async def write_registers(call: Call, arguments: WriteRegisters) -> RegisterValues:
        """Write up to 123 holding registers in one request (function 16)."""
        await put_registers(call, arguments, arguments.address, arguments.values)
        return {"address": arguments.address, "count": len(arguments.values), "values": arguments.values}

    @server.tool("modbus.write_coil", writes=True)
    async def write_coil(call: Call, arguments: WriteCoil) -> CoilState:
        """Switch one coil (function 05)."""
        await exchange(
            call,
            arguments,
            lambda client, unit: client.write_coil(arguments.address, arguments.value, device_id=unit),
        )
        return {"address": arguments.address, "value": arguments.value}

    @server.tool("modbus.write_coil", writes=True)
    async def write_coils_bulk(call: Call, arguments: WriteCoils) -> BitStates:
        """Switch up to 1968 coils in one request (function 15)."""
        await exchange(
            call,
            arguments,
            lambda client, unit: client.write_coils(arguments.address, arguments.values, device_id=unit),
        )
        return {"address": arguments.address, "count": len(arguments.values), "values": arguments.values}

    @server.tool("modbus.mask_write", writes=True)
    async def mask_write_register(call: Call, arguments: MaskWrite) -> Masked:
        """Change single bits of a holding register atomically in the device (function 22):
        new value = (old AND and_mask) OR (or_mask AND NOT and_mask)."""
        await exchange(
            call,
            arguments,
            lambda client, unit: client.mask_write_register(
                address=arguments.address,
                and_mask=arguments.and_mask,
                or_mask=arguments.or_mask,
                device_id=unit,
            ),
        )
        return {"address": arguments.address, "and_mask": arguments.and_mask, "or_mask": arguments.or_mask}

    @server.tool("modbus.write_tag", writes=True)
    async def write_tag(call: Call, arguments: WriteTag) -> TagWritten:
        """Write a tag's engineering value, rounded to the nearest raw value."""
        tag = known_tag(arguments.tag)
        if not tag.writable:
            raise AdapterError("not_writable", "the tag map does not allow writing this tag", outcome="not_sent")
        raw = raw_value(tag, arguments.value)
        await put_registers(call, Unit(), tag.address, encode(raw, tag.type, tag.order))
        return {"tag": arguments.tag, "value": arguments.value, "raw": raw, "unit": tag.unit}

    def known_tag(name: str) -> Tag:
        if name not in tags:
            message = "the tag map has no such tag; list_tags lists them"
            raise AdapterError("illegal_address", message, field="/tag", outcome="not_sent")
        return tags[name]

    return server


def _bit_states(arguments: Bits, reply: ModbusPDU) -> BitStates:
    # The reply is padded to whole bytes; only what was asked for is an answer.
    values = [bool(bit) for bit in reply.bits[: arguments.count]]
    return {"address": arguments.address, "count": arguments.count, "values": values}
