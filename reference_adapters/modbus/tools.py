"""The seventeen tools. Addresses are those of the PDU, from 0."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field
from pymodbus.pdu import ModbusPDU

from ..core import AdapterError, AdapterServer, Arguments, BoundsCode, Call, Environment
from .codec import DataType, Order, decode, encode, width
from .link import Link, Send
from .tags import load_tags, nearest_raw

__all__ = ["build"]

# MODBUS Application Protocol V1.1b3, sections 6.1 to 6.12: what one PDU can carry.
MAX_READ_BITS, MAX_READ_REGISTERS, MAX_WRITE_BITS, MAX_WRITE_REGISTERS = 2000, 125, 1968, 123

Address = Annotated[int, Field(ge=0, le=65535, description="PDU address, from 0")]
Unit = Annotated[int | None, Field(ge=0, le=255, description="unit identifier; the configured one if left out")]
RegisterValue = Annotated[int, Field(ge=0, le=65535, description="0 to 65535"), BoundsCode("range_overflow")]
Limit = BoundsCode("limit_exceeded")


class NoArguments(Arguments):
    """Of tools that only need to know the unit."""

    unit_id: Unit = None


class One(NoArguments):
    """One cell."""

    address: Address


class Registers(One):
    """A block of registers."""

    count: Annotated[int, Field(ge=1, le=MAX_READ_REGISTERS, description="1 to 125"), Limit]


class Bits(One):
    """A block of coils or discrete inputs."""

    count: Annotated[int, Field(ge=1, le=MAX_READ_BITS, description="1 to 2000"), Limit]


class WriteRegister(One):
    """One register and its value."""

    value: RegisterValue


class WriteRegisters(One):
    """A block of registers and their values."""

    values: Annotated[
        list[Annotated[int, Field(ge=0, le=65535)]],
        Field(min_length=1, max_length=MAX_WRITE_REGISTERS),
        BoundsCode("range_overflow"),
    ]


class WriteCoil(One):
    """One coil and its state."""

    value: bool


class WriteCoils(One):
    """A block of coils and their states."""

    values: Annotated[list[bool], Field(min_length=1, max_length=MAX_WRITE_BITS)]


class MaskWrite(One):
    """New value = (old AND and_mask) OR (or_mask AND NOT and_mask)."""

    and_mask: RegisterValue
    or_mask: RegisterValue


class Typed(One):
    """A value that may span registers."""

    data_type: DataType
    order: Order = "ABCD"


class TagName(Arguments):
    """A tag of the tag map."""

    tag: Annotated[str, Field(min_length=1, max_length=200)]


class WriteTag(TagName):
    """A tag and its engineering value."""

    value: float


class Nothing(Arguments):
    """No arguments."""


def build() -> AdapterServer:
    """The adapter as the environment configures it.

    Raises:
        ConfigError: a setting cannot be used.
    """
    environment = Environment()
    host = environment.text("MODBUS_HOST", "127.0.0.1")
    port = environment.whole("MODBUS_PORT", 502, 1, 65535)
    default_unit = environment.whole("MODBUS_UNIT_ID", 1, 0, 255)
    tags = load_tags(environment.optional("MODBUS_TAG_MAP"))
    link = Link(host, port, environment.seconds("MODBUS_TIMEOUT_S", 1.0))
    server = AdapterServer(
        name="modbus-reference",
        version="0.1.0",
        protocol="modbus-tcp",
        endpoint=f"modbus+tcp://{host}:{port}",
        writes_enabled=environment.writes_enabled("MODBUS_WRITES_ENABLED"),
        switch="MODBUS_WRITES_ENABLED",
        deadline_s=environment.seconds("MODBUS_DEADLINE_S", 3.0),
        close=link.close,
    )

    def unit_of(arguments: NoArguments) -> int:
        unit = default_unit if arguments.unit_id is None else arguments.unit_id
        if 248 <= unit <= 254:
            # Messaging on TCP/IP V1.0b, section 4.4.1.2: reserved.
            raise AdapterError("invalid_input", "unit identifiers 248 to 254 are reserved", field="/unit_id")
        return unit

    async def exchange(call: Call, arguments: NoArguments, send: Send, **trace: Any) -> ModbusPDU:
        reply = await link.exchange(call, unit_of(arguments), send)
        call.trace.update(trace)
        return reply

    def within(address: int, count: int) -> None:
        if address + count > 65536:
            raise AdapterError("limit_exceeded", "address and count run past 65535", field="/count")

    async def registers(call: Call, arguments: NoArguments, table: str, address: int, count: int) -> list[int]:
        within(address, count)
        unit = unit_of(arguments)

        def send(client: Any) -> Any:
            read = client.read_input_registers if table == "input" else client.read_holding_registers
            return read(address, count=count, device_id=unit)

        reply = await exchange(call, arguments, send, address=address, count=count)
        if reply.function_code != (4 if table == "input" else 3) or len(reply.registers) != count:
            raise AdapterError("protocol_error", "the reply does not have the registers that were asked for")
        return list(reply.registers)

    async def bits(call: Call, arguments: Bits, table: str) -> dict[str, Any]:
        within(arguments.address, arguments.count)
        unit = unit_of(arguments)

        def send(client: Any) -> Any:
            read = client.read_coils if table == "coils" else client.read_discrete_inputs
            return read(arguments.address, count=arguments.count, device_id=unit)

        reply = await exchange(call, arguments, send, address=arguments.address, count=arguments.count)
        # The reply is padded to whole bytes; only what was asked for is an answer.
        if reply.function_code != (1 if table == "coils" else 2) or len(reply.bits) < arguments.count:
            raise AdapterError("protocol_error", "the reply does not have the bits that were asked for")
        values = list(reply.bits[: arguments.count])
        return {"address": arguments.address, "count": arguments.count, "values": values}

    def confirmed(reply: ModbusPDU, function: int, address: int) -> None:
        # The response to a write echoes it; anything else leaves open what the device did.
        if reply.function_code != function or reply.address != address:
            raise AdapterError("protocol_error", "the confirmation does not match the write", outcome="unknown")

    async def put_registers(call: Call, arguments: NoArguments, address: int, values: list[int]) -> None:
        within(address, len(values))
        unit = unit_of(arguments)
        reply = await exchange(
            call,
            arguments,
            lambda client: client.write_registers(address, values, device_id=unit),
            address=address,
            count=len(values),
        )
        confirmed(reply, 16, address)
        if reply.count != len(values):
            raise AdapterError("protocol_error", "the confirmation does not match the write", outcome="unknown")

    # -- reading --------------------------------------------------------------------------------------------

    @server.tool("modbus.ping")
    async def ping(call: Call, arguments: NoArguments) -> dict[str, Any]:
        """Confirm that the device answers: reads holding register 0 and accepts any well-formed reply."""
        try:
            await registers(call, arguments, "holding", 0, 1)
        except AdapterError as error:
            # An exception reply is an answer too: the device is there.
            if "exception_code" not in call.trace or error.code.startswith("gateway"):
                raise
        return {"reachable": True}

    @server.tool("modbus.read_holding")
    async def read_register(call: Call, arguments: One) -> dict[str, Any]:
        """Read one holding register (function 03)."""
        (value,) = await registers(call, arguments, "holding", arguments.address, 1)
        return {"address": arguments.address, "value": value}

    @server.tool("modbus.read_holding")
    async def read_multiple_holding_registers(call: Call, arguments: Registers) -> dict[str, Any]:
        """Read up to 125 holding registers (function 03)."""
        values = await registers(call, arguments, "holding", arguments.address, arguments.count)
        return {"address": arguments.address, "count": arguments.count, "values": values}

    @server.tool("modbus.read_input")
    async def read_input_registers(call: Call, arguments: Registers) -> dict[str, Any]:
        """Read up to 125 input registers (function 04)."""
        values = await registers(call, arguments, "input", arguments.address, arguments.count)
        return {"address": arguments.address, "count": arguments.count, "values": values}

    @server.tool("modbus.read_coils")
    async def read_coils(call: Call, arguments: Bits) -> dict[str, Any]:
        """Read up to 2000 coils (function 01)."""
        return await bits(call, arguments, "coils")

    @server.tool("modbus.read_discrete")
    async def read_discrete_inputs(call: Call, arguments: Bits) -> dict[str, Any]:
        """Read up to 2000 discrete inputs (function 02)."""
        return await bits(call, arguments, "discrete_inputs")

    @server.tool("modbus.read_typed")
    async def read_holding_typed(call: Call, arguments: Typed) -> dict[str, Any]:
        """Read a number that spans holding registers, in one request."""
        count = width(arguments.data_type)
        block = await registers(call, arguments, "holding", arguments.address, count)
        return {"address": arguments.address, **decode(block, arguments.data_type, arguments.order)}

    @server.tool("modbus.read_typed")
    async def read_input_typed(call: Call, arguments: Typed) -> dict[str, Any]:
        """Read a number that spans input registers, in one request."""
        block = await registers(call, arguments, "input", arguments.address, width(arguments.data_type))
        return {"address": arguments.address, **decode(block, arguments.data_type, arguments.order)}

    @server.tool("modbus.identify")
    async def read_device_information(call: Call, arguments: NoArguments) -> dict[str, Any]:
        """Read the device's identification (function 2B/0E, regular objects)."""
        unit = unit_of(arguments)
        reply = await exchange(
            call, arguments, lambda client: client.read_device_information(read_code=2, object_id=0, device_id=unit)
        )
        information = getattr(reply, "information", {})
        return {"objects": {str(key): value.decode("utf-8", "replace") for key, value in information.items()}}

    @server.tool("modbus.list_tags")
    async def list_tags(call: Call, arguments: Nothing) -> dict[str, Any]:
        """List the names of the tag map."""
        return {"tags": [{"tag": name, **tag.model_dump()} for name, tag in sorted(tags.items())]}

    @server.tool("modbus.read_tag")
    async def read_tag(call: Call, arguments: TagName) -> dict[str, Any]:
        """Read a tag's engineering value."""
        tag = known_tag(arguments.tag)
        block = await registers(call, NoArguments(), tag.table, tag.address, width(tag.type))
        reading = decode(block, tag.type, tag.order)
        if isinstance(reading["value"], int | float) and (tag.scale, tag.offset) != (1.0, 0.0):
            reading["value"] = reading["value"] * tag.scale + tag.offset
        return {"tag": arguments.tag, "unit": tag.unit, **reading}

    # -- writing --------------------------------------------------------------------------------------------

    @server.tool("modbus.write_holding", writes=True)
    async def write_register(call: Call, arguments: WriteRegister) -> dict[str, Any]:
        """Write one holding register (function 06)."""
        unit = unit_of(arguments)
        address, value = arguments.address, arguments.value
        reply = await exchange(
            call,
            arguments,
            lambda client: client.write_register(address, value, device_id=unit),
            address=address,
            count=1,
        )
        confirmed(reply, 6, address)
        if list(reply.registers) != [value]:
            raise AdapterError("protocol_error", "the confirmation echoes another value", outcome="unknown")
        return {"address": address, "value": value}

    @server.tool("modbus.write_holding", writes=True)
    async def write_registers(call: Call, arguments: WriteRegisters) -> dict[str, Any]:
        """Write up to 123 holding registers in one request (function 16)."""
        await put_registers(call, arguments, arguments.address, arguments.values)
        return {"address": arguments.address, "count": len(arguments.values), "values": arguments.values}

    @server.tool("modbus.write_coil", writes=True)
    async def write_coil(call: Call, arguments: WriteCoil) -> dict[str, Any]:
        """Switch one coil (function 05)."""
        unit = unit_of(arguments)
        reply = await exchange(
            call,
            arguments,
            lambda client: client.write_coil(arguments.address, arguments.value, device_id=unit),
            address=arguments.address,
            count=1,
        )
        confirmed(reply, 5, arguments.address)
        if list(reply.bits[:1]) != [arguments.value]:
            raise AdapterError("protocol_error", "the confirmation echoes another state", outcome="unknown")
        return {"address": arguments.address, "value": arguments.value}

    @server.tool("modbus.write_coil", writes=True)
    async def write_coils_bulk(call: Call, arguments: WriteCoils) -> dict[str, Any]:
        """Switch up to 1968 coils in one request (function 15)."""
        within(arguments.address, len(arguments.values))
        unit = unit_of(arguments)
        reply = await exchange(
            call,
            arguments,
            lambda client: client.write_coils(arguments.address, arguments.values, device_id=unit),
            address=arguments.address,
            count=len(arguments.values),
        )
        confirmed(reply, 15, arguments.address)
        if reply.count != len(arguments.values):
            raise AdapterError("protocol_error", "the confirmation does not match the write", outcome="unknown")
        return {"address": arguments.address, "count": len(arguments.values), "values": arguments.values}

    @server.tool("modbus.mask_write", writes=True)
    async def mask_write_register(call: Call, arguments: MaskWrite) -> dict[str, Any]:
        """Change single bits of a holding register atomically in the device (function 22)."""
        unit = unit_of(arguments)
        reply = await exchange(
            call,
            arguments,
            lambda client: client.mask_write_register(
                address=arguments.address,
                and_mask=arguments.and_mask,
                or_mask=arguments.or_mask,
                device_id=unit,
            ),
            address=arguments.address,
            count=1,
        )
        confirmed(reply, 22, arguments.address)
        return {"address": arguments.address, "and_mask": arguments.and_mask, "or_mask": arguments.or_mask}

    @server.tool("modbus.write_tag", writes=True)
    async def write_tag(call: Call, arguments: WriteTag) -> dict[str, Any]:
        """Write a tag's engineering value, rounded to the nearest raw value."""
        tag = known_tag(arguments.tag)
        if tag.table != "holding" or not tag.writable:
            raise AdapterError("not_writable", "the tag map does not allow writing this tag", outcome="not_sent")
        raw = nearest_raw(tag, arguments.value)
        await put_registers(call, NoArguments(), tag.address, encode(raw, tag.type, tag.order))
        return {"tag": arguments.tag, "value": arguments.value, "raw": raw}

    def known_tag(name: str) -> Any:
        if name not in tags:
            raise AdapterError("illegal_address", "the tag map has no such tag", field="/tag", outcome="not_sent")
        return tags[name]

    return server
