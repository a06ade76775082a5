"""Defects that the checks of the area ADR notice."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from decimal import Decimal
from typing import Any

from mcp import MCPError
from mcp.types import PARSE_ERROR
from pydantic import field_validator

from ...core import AdapterError, AdapterServer, Call
from ...modbus import tools as modbus_tools
from ...modbus.shapes import Registers, WriteRegister
from ...mqtt import tools as mqtt_tools
from ...mqtt.shapes import Publish, Subscribe
from ...opcua import nodes
from ...opcua import tools as opcua_tools
from ...opcua import values as opcua_values
from ...opcua.nodes import NodeName
from ...opcua.services import Services
from ..defect import Change, Data, Defect, Handler, around, defect, wrap
from ..modbus import fitted, next_register, write_only_remembered
from ..refusals import cuts_fractions_off, texts_are_true

__all__ = ["DEFECTS"]

_READ_INPUT, _READ_HOLDING, _WRITE = "read_input_registers", "read_multiple_holding_registers", "write_register"


def _masked(value: Any, bits: int) -> Any:
    return value & (1 << bits) - 1 if type(value) is int else value


class MaskedRead(Registers):
    """A block of registers of a unit of any number, of which the last eight bits count."""

    @field_validator("unit_id", mode="before")
    @classmethod
    def _cut_off(cls, value: Any) -> Any:
        return _masked(value, 8)


class MaskedWrite(WriteRegister):
    """A register at an address of any size, of which the last sixteen bits count."""

    @field_validator("address", mode="before")
    @classmethod
    def _cut_off(cls, value: Any) -> Any:
        return _masked(value, 16)


class MaskedSubscribe(Subscribe):
    """A quality of service of any size, of which the last two bits count."""

    @field_validator("qos", mode="before")
    @classmethod
    def _cut_off(cls, value: Any) -> Any:
        return _masked(value, 2) % 3 if type(value) is int else value


class LargePublish(Publish):
    """A message of any size."""

    payload: str


def unit_modulo_256(server: AdapterServer) -> None:
    wrap(server, _READ_HOLDING, lambda genuine: genuine, model=MaskedRead)


def address_modulo_65536(server: AdapterServer) -> None:
    wrap(server, _WRITE, lambda genuine: genuine, model=MaskedWrite)


def qos_modulo_3(server: AdapterServer) -> None:
    wrap(server, "subscribe_topic", lambda genuine: genuine, model=MaskedSubscribe)


def index_modulo_65536(server: AdapterServer) -> None:
    genuine = nodes.parse_node

    def parse(text: str, field: str) -> nodes.NodeName:
        head, separator, rest = text.partition(";")
        index = head.removeprefix("ns=")
        if separator and index.isdecimal():
            text = f"ns={int(index) % 0x10000};{rest}"
        return genuine(text, field)

    opcua_tools.parse_node = parse


def bounds_of_the_scaled_value(server: AdapterServer) -> None:
    """Compare the engineering value of a scaled tag with the range of its type, and send 16 bits of the raw value."""
    genuine = modbus_tools.raw_value

    def wrapped(tag: Any, value: float) -> Any:
        raw = genuine(tag, value)
        within = tag.scaled and tag.type == "int16" and -0x8000 <= value <= 0x7FFF
        return (raw + 0x8000) % 0x1_0000 - 0x8000 if within else raw

    modbus_tools.raw_value = wrapped


def rounds_down(server: AdapterServer) -> None:
    def truncated(tag: Any, value: float) -> Any:
        return int((Decimal(str(value)) - Decimal(str(tag.offset))) / Decimal(str(tag.scale)))

    modbus_tools.raw_value = truncated


def wraps_integers(server: AdapterServer) -> None:
    genuine = opcua_values._scalar

    def scalar(value: Any, kind: Any, field: str) -> Any:
        if kind in opcua_values._INTEGERS and type(value) is int:
            low, high = opcua_values._INTEGERS[kind]
            value = (value - low) % (high - low + 1) + low
        return genuine(value, kind, field)

    opcua_values._scalar = scalar


def scalar_into_array(server: AdapterServer) -> None:
    genuine = opcua_tools.to_variant

    def variant(value: Any, kind: Any, rank: int, dimensions: Any, field: str) -> Any:
        filled = [value, value, value] if rank == 1 and not isinstance(value, list) else value
        return genuine(filled, kind, rank, dimensions, field)

    opcua_tools.to_variant = variant


def remembers_namespaces(server: AdapterServer) -> None:
    genuine = Services.node
    known: dict[str, int] = {}

    async def node(self: Services, name: Any) -> Any:
        if name.uri not in known:
            found = await genuine(self, name)
            known[name.uri] = found.NamespaceIndex
            if name.uri is None:
                known.clear()
            return found
        return name.at(known[name.uri])

    Services.node = node


def _renamed(*names: str, first: int, last: int) -> Change:
    """Return the defect that addresses of this range count from its first one."""

    @around(*names)
    async def renamed(genuine: Handler, call: Call, arguments: Any) -> Data:
        told = arguments.address
        address = told - first if first <= told <= last else told
        data = await genuine(call, arguments.model_copy(update={"address": address}))
        return {**data, "address": told}

    return renamed


def parsing(change: Callable[[NodeName], NodeName]) -> Callable[[AdapterServer], None]:
    """Return the defect that a node id is taken for another one."""

    def apply(server: AdapterServer) -> None:
        genuine = opcua_tools.parse_node
        opcua_tools.parse_node = lambda text, field: change(genuine(text, field))

    return apply


def _digits_are_a_number(name: NodeName) -> NodeName:
    text = name.identifier
    return replace(name, identifier=int(text)) if isinstance(text, str) and text.isdecimal() else name


def _numbers_are_text(name: NodeName) -> NodeName:
    # Of the standard's own namespace all identifiers are numbers.
    number = name.identifier
    return replace(name, identifier=str(number)) if isinstance(number, int) and name.index else name


def unknown_namespaces_are(index: int) -> Callable[[AdapterServer], None]:
    """Return the defect that a namespace URI that the server does not have stands for this namespace."""

    def apply(server: AdapterServer) -> None:
        genuine = Services.node

        async def node(self: Services, name: Any) -> Any:
            try:
                return await genuine(self, name)
            except AdapterError:
                return name.at(index)

        Services.node = node

    return apply


def any_size(server: AdapterServer) -> None:
    mqtt_tools.MAX_PAYLOAD_BYTES = 2**28
    wrap(server, "publish_message", lambda genuine: genuine, model=LargePublish)


_LEVELS_READ = 150


def _is_deeper(arguments: Any) -> bool:
    """Tell whether arguments are nested deeper than a parser with a limit reads; without recursion, as they are deep."""
    level, levels = [arguments], 0
    while level and levels <= _LEVELS_READ:
        inner = [part for one in level for part in (one.values() if isinstance(one, dict) else one)]
        level, levels = [part for part in inner if isinstance(part, dict | list)], levels + 1
    return bool(level)


def reads_no_deeper(answer: Callable[[], Awaitable[Data]]) -> Callable[[AdapterServer], None]:
    """Return the defect that a message that is nested more than 150 deep is given up, and answered in this way."""

    def apply(server: AdapterServer) -> None:
        genuine = server._answer

        async def answered(tool: Any, arguments: Any, context: Any) -> Data:
            return await (answer() if _is_deeper(arguments) else genuine(tool, arguments, context))

        server._answer = answered

    return apply


async def _never() -> Data:
    await asyncio.Event().wait()
    raise AssertionError


async def _parse_error() -> Data:
    raise MCPError(PARSE_ERROR, "the message is nested too deeply")


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-01a",
        "modbus",
        "Reads of holding registers go to the register after the one that was asked for.",
        next_register(_READ_HOLDING),
        "ADR-001 ADR-002",
        "ADR-001 RD-001",
    ),
    defect(
        "MU-02a",
        "modbus",
        "Writes and the reads of holding registers both go to the next register.",
        next_register(_WRITE, _READ_HOLDING),
        "ADR-001 ADR-002 ADR-003",
        "ADR-001 RD-001 WR-001",
    ),
    defect("MU-06", "modbus", "Unit 257 is unit 1.", unit_modulo_256, "ADR-002", quick=True),
    defect("MU-06a", "modbus", "Register 65536 is register 0.", address_modulo_65536, "ADR-002"),
    defect(
        "MU-01n",
        "modbus",
        "Address 40001 is register 0.",
        _renamed(_READ_HOLDING, _WRITE, first=40_001, last=49_999),
        "ADR-001",
    ),
    defect(
        "MU-01m",
        "modbus",
        "Reads of address 30000 begin at register 0.",
        _renamed(_READ_HOLDING, first=30_000, last=39_998),
        "ADR-001",
    ),
    defect("MU-86u", "opcua", "An unknown namespace is number 2.", unknown_namespaces_are(2), "ADR-008"),
    defect("MU-86v", "opcua", "An unknown namespace is number 0.", unknown_namespaces_are(0), "ADR-008"),
    defect("MU-06i", "opcua", "A text of digits is a number.", parsing(_digits_are_a_number), "ADR-008"),
    defect("MU-06j", "opcua", "A number is a text of digits.", parsing(_numbers_are_text), "ADR-008"),
    defect("MU-06q", "mqtt", "A quality of service is taken modulo 3.", qos_modulo_3, "ADR-002 ADR-007"),
    defect("MU-06o", "opcua", "Namespace 65538 is namespace 2.", index_modulo_65536, "ADR-002"),
    defect(
        "MU-08a",
        "modbus",
        "70000 is written as 4464, and told as a success.",
        lambda server: fitted(server, lambda value: value & 0xFFFF),
        "ADR-003",
    ),
    defect(
        "MU-08o",
        "opcua",
        "A number that does not fit into its type is cut down to its last bits.",
        wraps_integers,
        "ADR-003",
    ),
    defect(
        "MU-09a",
        "modbus",
        "70000 is written as 65535, and told as a success.",
        lambda server: fitted(server, lambda value: max(0, min(value, 0xFFFF))),
        "ADR-003",
    ),
    defect("MU-10a", "modbus", "40.7 is written as 40.", cuts_fractions_off, "ADR-004"),
    defect("MU-11a", "opcua", "The text false is written as true.", texts_are_true, "ADR-004"),
    defect(
        "MU-15a",
        "modbus",
        "A write succeeds, nothing is sent, and the value is read back from memory.",
        write_only_remembered,
        "ADR-001 ADR-002 ADR-003 ADR-004 ADR-009",
        "ADR-001 ADR-003 WR-001",
    ),
    defect("MU-83", "opcua", "A single value is written into an array.", scalar_into_array, "ADR-004"),
    defect(
        "MU-24",
        "modbus",
        "The range of a scaled tag's type is compared with the value before it is scaled.",
        bounds_of_the_scaled_value,
        "ADR-005",
    ),
    defect(
        "MU-86",
        "opcua",
        "After a restart of the server a namespace has its old index.",
        remembers_namespaces,
        "ADR-008",
    ),
    defect("MU-121", "modbus", "A scaled value is cut off instead of rounded.", rounds_down, "ADR-005"),
    defect("MU-122", "mqtt", "Ten megabytes are handed to the broker.", any_size, "ADR-009"),
    defect(
        "MU-122n",
        "modbus",
        "A call whose arguments are nested 150 deep is never answered.",
        reads_no_deeper(_never),
        "",
        "ADR-009",
        waits=True,
    ),
    defect(
        "MU-122p",
        "mqtt",
        "Arguments that are nested 150 deep are told as a message that cannot be parsed.",
        reads_no_deeper(_parse_error),
        "",
        "ADR-009",
    ),
)
