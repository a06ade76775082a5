"""Defects that the checks of the area RD notice."""

from __future__ import annotations

from typing import Any

from ...core import AdapterServer, Call
from ...modbus import link, tools
from ...modbus.shapes import Registers, Typed
from ...modbus.wire import Frame, reply_pdu
from ...opcua import tools as opcua_tools
from ..any_protocol import answers_from_memory_when_gone, answers_twice_from_one_exchange
from ..modbus import input_registers_for_holding, next_register
from ..mutant import Data, Handler, Mutant, wrap
from ..refusals import begins_at_0_again, instead_of

__all__ = ["MUTANTS"]

_READ_INPUT, _READ_HOLDING = "read_input_registers", "read_multiple_holding_registers"
_MOST = 125


def always_unit_1(server: AdapterServer) -> None:
    genuine = tools.Tools._exchange

    async def exchange(self: Any, call: Call, arguments: Any, send: Any) -> Any:
        return await genuine(self, call, arguments.model_copy(update={"unit_id": 1}), send)

    tools.Tools._exchange = exchange


def any_transaction(server: AdapterServer) -> None:
    def lenient(request: Frame, received: bytes) -> bytes:
        return reply_pdu(request, request.transaction.to_bytes(2, "big") + received[2:])

    link.reply_pdu = lenient
    link.is_other_reply = lambda request, received: False


def whole_bytes_of_bits(server: AdapterServer) -> None:
    def padded(arguments: Any, reply: Any) -> Data:
        values = [bool(bit) for bit in reply.bits]
        return {"address": arguments.address, "count": len(values), "values": values}

    tools._bit_states = padded


def first_bit_told_last(server: AdapterServer) -> None:
    """Take the highest bit of each byte for its first: a device sends the first one lowest."""
    genuine = tools._bit_states

    def turned(arguments: Any, reply: Any) -> Data:
        data: Data = genuine(arguments, reply)
        values = data["values"]
        parts = (values[at : at + 8] for at in range(0, len(values), 8))
        return {**data, "values": [bit for part in parts for bit in (*part[1:], *part[:1])]}

    tools._bit_states = turned


class AnyNumber(Registers):
    """A block of registers of any length."""

    count: int


def capped_at_125(server: AdapterServer) -> None:
    def capped(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data: Data = await genuine(call, arguments.model_copy(update={"count": min(arguments.count, _MOST)}))
            return data

        return handler

    wrap(server, _READ_HOLDING, capped, model=AnyNumber)


def register_by_register(server: AdapterServer) -> None:
    genuine = tools.Tools._holding

    async def torn(self: Any, call: Call, arguments: Any, address: int, count: int) -> list[int]:
        if not isinstance(arguments, Typed):
            return await genuine(self, call, arguments, address, count)
        return [(await genuine(self, call, arguments, address + index, 1))[0] for index in range(count)]

    tools.Tools._holding = torn


def unsigned_as_signed(server: AdapterServer) -> None:
    genuine = opcua_tools.from_variant

    def signed(variant: Any, clean: Any) -> Any:
        found = genuine(variant, clean)
        if found["data_type"] == "UInt16" and found["value"] > 0x7FFF:
            found["value"] -= 0x10000
        return found

    opcua_tools.from_variant = signed


MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        id="MU-01r",
        protocol="modbus",
        sentence="Reads go to the register after the one that was asked for.",
        bend=next_register(_READ_INPUT, _READ_HOLDING),
        items="RD-001.modbus RD-002.modbus RD-003.modbus RD-004.modbus RD-005.modbus RD-007.modbus",
        requirements="RD-001 RD-002 RD-003 RD-004 RD-007",
        areas="rd",
    ),
    Mutant(
        id="MU-01s",
        protocol="opcua",
        sentence="Numbers of 16 bits without a sign are read as numbers with one.",
        bend=unsigned_as_signed,
        items="RD-001.opcua",
        requirements="RD-001",
        areas="rd",
    ),
    Mutant(
        id="MU-05",
        protocol="modbus",
        sentence="Whatever unit is asked for, it is unit 1.",
        bend=always_unit_1,
        items="RD-003.modbus",
        requirements="RD-003",
        areas="rd",
    ),
    Mutant(
        id="MU-07r",
        protocol="modbus",
        sentence="Holding registers are read with function 4.",
        bend=input_registers_for_holding,
        items="RD-001.modbus RD-002.modbus RD-003.modbus RD-004.modbus RD-005.modbus RD-007.modbus",
        requirements="RD-001 RD-002 RD-003 RD-004 RD-005 RD-007",
        areas="rd",
    ),
    Mutant(
        id="MU-35r",
        protocol="modbus",
        sentence="While the device is gone, holding registers are read with the values that were read before.",
        bend=answers_from_memory_when_gone(_READ_HOLDING),
        items="RD-004.modbus",
        requirements="RD-004",
        areas="rd",
    ),
    Mutant(
        id="MU-36r",
        protocol="modbus",
        sentence="Holding registers that are read soon after are answered from memory, as if from the device.",
        bend=answers_twice_from_one_exchange(_READ_HOLDING),
        items="RD-001.modbus RD-002.modbus RD-004.modbus RD-005.modbus RD-007.modbus",
        requirements="ENV-008 RD-001 RD-002 RD-004 RD-005 RD-007",
        areas="rd",
    ),
    Mutant(
        id="MU-36s",
        protocol="opcua",
        sentence="A node that is read soon after is answered from memory, as if from the server.",
        bend=answers_twice_from_one_exchange("read_opcua_node"),
        items="RD-001.opcua RD-004.opcua",
        requirements="ENV-008 RD-001 RD-004",
        areas="rd",
    ),
    Mutant(
        id="MU-39",
        protocol="modbus",
        sentence="An answer with any transaction identifier is accepted.",
        bend=any_transaction,
        items="RD-005.modbus",
        requirements="RD-005",
        areas="rd",
    ),
    Mutant(
        id="MU-40r",
        protocol="modbus",
        sentence="Registers that the device did not send are 0.",
        bend=instead_of("protocol_error", lambda arguments: [0] * arguments.count),
        items="RD-003.modbus RD-005.modbus",
        requirements="RD-003 RD-005",
        areas="rd",
    ),
    Mutant(
        id="MU-41",
        protocol="modbus",
        sentence="The two registers of a float are read in two requests.",
        bend=register_by_register,
        items="RD-007.modbus",
        requirements="RD-007",
        areas="rd",
    ),
    Mutant(
        id="MU-42",
        protocol="modbus",
        sentence="Coils are read with the padding of their last byte.",
        bend=whole_bytes_of_bits,
        items="RD-001.modbus RD-002.modbus RD-006.modbus RD-007.modbus",
        requirements="RD-001 RD-002 RD-006 RD-007",
        areas="rd",
    ),
    Mutant(
        id="MU-42r",
        protocol="modbus",
        sentence="The first bit of each byte is told as its last.",
        bend=first_bit_told_last,
        items="RD-001.modbus RD-006.modbus RD-007.modbus",
        requirements="RD-001 RD-006 RD-007",
        areas="rd",
    ),
    Mutant(
        id="MU-43",
        protocol="modbus",
        sentence="Of 126 registers 125 are read.",
        bend=capped_at_125,
        items="RD-007.modbus",
        requirements="ERR-001 ERR-002 RD-007",
        areas="rd",
    ),
    Mutant(
        id="MU-44r",
        protocol="modbus",
        sentence="Two registers from 65535 are 65535 and 0.",
        bend=begins_at_0_again,
        items="RD-007.modbus",
        requirements="RD-007",
        areas="rd",
    ),
)
