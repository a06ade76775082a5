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
from ..modbus import fitted, next_register, write_only_remembered
from ..mutant import Data, Handler, Mutant, each, wrap
from ..refusals import cuts_fractions_off, texts_are_true

__all__ = ["MUTANTS"]

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


def _renamed(first: int, last: int) -> Callable[[Handler], Handler]:
    """Return the change that addresses of this range count from its first one."""

    def change(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            told = arguments.address
            address = told - first if first <= told <= last else told
            data: Data = await genuine(call, arguments.model_copy(update={"address": address}))
            return {**data, "address": told}

        return handler

    return change


def parsing(change: Callable[[NodeName], NodeName]) -> Callable[[AdapterServer], None]:
    """Return the defect that a node id is taken for another one."""

    def bend(server: AdapterServer) -> None:
        genuine = opcua_tools.parse_node
        opcua_tools.parse_node = lambda text, field: change(genuine(text, field))

    return bend


def _digits_are_a_number(name: NodeName) -> NodeName:
    text = name.identifier
    return replace(name, identifier=int(text)) if isinstance(text, str) and text.isdecimal() else name


def _numbers_are_text(name: NodeName) -> NodeName:
    # Of the standard's own namespace all identifiers are numbers.
    number = name.identifier
    return replace(name, identifier=str(number)) if isinstance(number, int) and name.index else name


def unknown_namespaces_are(index: int) -> Callable[[AdapterServer], None]:
    """Return the defect that a namespace URI that the server does not have stands for this namespace."""

    def bend(server: AdapterServer) -> None:
        genuine = Services.node

        async def node(self: Services, name: Any) -> Any:
            try:
                return await genuine(self, name)
            except AdapterError:
                return name.at(index)

        Services.node = node

    return bend


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

    def bend(server: AdapterServer) -> None:
        genuine = server._answer

        async def answered(tool: Any, arguments: Any) -> Data:
            return await (answer() if _is_deeper(arguments) else genuine(tool, arguments))

        server._answer = answered

    return bend


async def _never() -> Data:
    await asyncio.Event().wait()
    raise AssertionError


async def _parse_error() -> Data:
    raise MCPError(PARSE_ERROR, "the message is nested too deeply")


MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        id="MU-01a",
        protocol="modbus",
        sentence="Reads of holding registers go to the register after the one that was asked for.",
        bend=next_register(_READ_HOLDING),
        items="ADR-001.modbus ADR-002.modbus",
        requirements="ADR-001 RD-001",
        areas="adr",
    ),
    Mutant(
        id="MU-02a",
        protocol="modbus",
        sentence="Writes and the reads of holding registers both go to the next register.",
        bend=next_register(_WRITE, _READ_HOLDING),
        items="ADR-001.modbus ADR-002.modbus ADR-003.modbus",
        requirements="ADR-001 RD-001 WR-001",
        areas="adr",
    ),
    Mutant(
        id="MU-06",
        protocol="modbus",
        sentence="Unit 257 is unit 1.",
        bend=unit_modulo_256,
        items="ADR-002.modbus",
        requirements="ADR-002",
        areas="adr",
        quick=True,
    ),
    Mutant(
        id="MU-06a",
        protocol="modbus",
        sentence="Register 65536 is register 0.",
        bend=address_modulo_65536,
        items="ADR-002.modbus",
        requirements="ADR-002",
        areas="adr",
    ),
    Mutant(
        id="MU-01n",
        protocol="modbus",
        sentence="Address 40001 is register 0.",
        bend=each(_READ_HOLDING, _WRITE, change=_renamed(40_001, 49_999)),
        items="ADR-001.modbus",
        requirements="ADR-001",
        areas="adr",
    ),
    Mutant(
        id="MU-01m",
        protocol="modbus",
        sentence="Reads of address 30000 begin at register 0.",
        bend=each(_READ_HOLDING, change=_renamed(30_000, 39_998)),
        items="ADR-001.modbus",
        requirements="ADR-001",
        areas="adr",
    ),
    Mutant(
        id="MU-86u",
        protocol="opcua",
        sentence="An unknown namespace is number 2.",
        bend=unknown_namespaces_are(2),
        items="ADR-008.opcua",
        requirements="ADR-008",
        areas="adr",
    ),
    Mutant(
        id="MU-86v",
        protocol="opcua",
        sentence="An unknown namespace is number 0.",
        bend=unknown_namespaces_are(0),
        items="ADR-008.opcua",
        requirements="ADR-008",
        areas="adr",
    ),
    Mutant(
        id="MU-06i",
        protocol="opcua",
        sentence="A text of digits is a number.",
        bend=parsing(_digits_are_a_number),
        items="ADR-008.opcua",
        requirements="ADR-008",
        areas="adr",
    ),
    Mutant(
        id="MU-06j",
        protocol="opcua",
        sentence="A number is a text of digits.",
        bend=parsing(_numbers_are_text),
        items="ADR-008.opcua",
        requirements="ADR-008",
        areas="adr",
    ),
    Mutant(
        id="MU-06q",
        protocol="mqtt",
        sentence="A quality of service is taken modulo 3.",
        bend=qos_modulo_3,
        items="ADR-002.mqtt ADR-007.mqtt",
        requirements="ADR-002 ADR-007",
        areas="adr",
    ),
    Mutant(
        id="MU-06o",
        protocol="opcua",
        sentence="Namespace 65538 is namespace 2.",
        bend=index_modulo_65536,
        items="ADR-002.opcua",
        requirements="ADR-002",
        areas="adr",
    ),
    Mutant(
        id="MU-08a",
        protocol="modbus",
        sentence="70000 is written as 4464, and told as a success.",
        bend=lambda server: fitted(server, lambda value: value & 0xFFFF),
        items="ADR-003.modbus",
        requirements="ADR-003",
        areas="adr",
    ),
    Mutant(
        id="MU-08o",
        protocol="opcua",
        sentence="A number that does not fit into its type is cut down to its last bits.",
        bend=wraps_integers,
        items="ADR-003.opcua",
        requirements="ADR-003",
        areas="adr",
    ),
    Mutant(
        id="MU-09a",
        protocol="modbus",
        sentence="70000 is written as 65535, and told as a success.",
        bend=lambda server: fitted(server, lambda value: max(0, min(value, 0xFFFF))),
        items="ADR-003.modbus",
        requirements="ADR-003",
        areas="adr",
    ),
    Mutant(
        id="MU-10a",
        protocol="modbus",
        sentence="40.7 is written as 40.",
        bend=cuts_fractions_off,
        items="ADR-004.modbus",
        requirements="ADR-004",
        areas="adr",
    ),
    Mutant(
        id="MU-11a",
        protocol="opcua",
        sentence="The text false is written as true.",
        bend=texts_are_true,
        items="ADR-004.opcua",
        requirements="ADR-004",
        areas="adr",
    ),
    Mutant(
        id="MU-15a",
        protocol="modbus",
        sentence="A write succeeds, nothing is sent, and the value is read back from memory.",
        bend=write_only_remembered,
        items="ADR-001.modbus ADR-002.modbus ADR-003.modbus ADR-004.modbus ADR-009.modbus",
        requirements="ADR-001 ADR-003 WR-001",
        areas="adr",
    ),
    Mutant(
        id="MU-83",
        protocol="opcua",
        sentence="A single value is written into an array.",
        bend=scalar_into_array,
        items="ADR-004.opcua",
        requirements="ADR-004",
        areas="adr",
    ),
    Mutant(
        id="MU-24",
        protocol="modbus",
        sentence="The range of a scaled tag's type is compared with the value before it is scaled.",
        bend=bounds_of_the_scaled_value,
        items="ADR-005.modbus",
        requirements="ADR-005",
        areas="adr",
    ),
    Mutant(
        id="MU-86",
        protocol="opcua",
        sentence="After a restart of the server a namespace has its old index.",
        bend=remembers_namespaces,
        items="ADR-008.opcua",
        requirements="ADR-008",
        areas="adr",
    ),
    Mutant(
        id="MU-121",
        protocol="modbus",
        sentence="A scaled value is cut off instead of rounded.",
        bend=rounds_down,
        items="ADR-005.modbus",
        requirements="ADR-005",
        areas="adr",
    ),
    Mutant(
        id="MU-122",
        protocol="mqtt",
        sentence="Ten megabytes are handed to the broker.",
        bend=any_size,
        items="ADR-009.mqtt",
        requirements="ADR-009",
        areas="adr",
    ),
    Mutant(
        id="MU-122n",
        protocol="modbus",
        sentence="A call whose arguments are nested 150 deep is never answered.",
        bend=reads_no_deeper(_never),
        items="",
        requirements="ADR-009",
        areas="adr",
        waits=True,
    ),
    Mutant(
        id="MU-122p",
        protocol="mqtt",
        sentence="Arguments that are nested 150 deep are told as a message that cannot be parsed.",
        bend=reads_no_deeper(_parse_error),
        items="",
        requirements="ADR-009",
        areas="adr",
    ),
)
