"""Defects that the checks of the area RD notice."""

from __future__ import annotations

import re
from typing import Any

from pymodbus.transport import ModbusProtocol

from ...core import AdapterServer, Call
from ...modbus import link, tools
from ...modbus.shapes import Registers, Typed
from ...modbus.wire import Frame, reply_pdu
from ...opcua import tools as opcua_tools
from ..any_protocol import answers_from_memory_when_gone, answers_twice_from_one_exchange
from ..defect import Data, Defect, Handler, around, defect
from ..modbus import input_registers_for_holding, next_register
from ..refusals import begins_at_0_again, instead_of

__all__ = ["DEFECTS"]

_READ_INPUT, _READ_HOLDING = "read_input_registers", "read_multiple_holding_registers"
_MOST = 125
_HALF = 64


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


def first_segment_alone(server: AdapterServer) -> None:
    """Take what one segment brings for the whole answer."""
    genuine = ModbusProtocol.data_received

    def received(self: ModbusProtocol, data: bytes) -> None:
        genuine(self, data)
        self.recv_buffer = b""

    ModbusProtocol.data_received = received


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


@around(_READ_HOLDING, model=AnyNumber)
async def capped_at_125(genuine: Handler, call: Call, arguments: Any) -> Data:
    data = await genuine(call, arguments.model_copy(update={"count": min(arguments.count, _MOST)}))
    return data


def long_blocks_remembered(server: AdapterServer) -> None:
    """Keep what is beyond the first 64 registers of a block from its first read."""
    kept: dict[int, list[Any]] = {}

    @around(_READ_HOLDING)
    async def remembering(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments)
        rest = kept.setdefault(arguments.address, data["values"][_HALF:])
        return {**data, "values": data["values"][:_HALF] + rest} if len(data["values"]) == _HALF + len(rest) else data

    remembering(server)


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


@around("read_opcua_node")
async def node_id_of_the_lowest_bits(genuine: Handler, call: Call, arguments: Any) -> Data:
    cut = re.sub(r"\bi=(\d+)$", lambda found: f"i={int(found[1]) & 0xFFFF}", arguments.node_id)
    data = await genuine(call, arguments.model_copy(update={"node_id": cut}))
    return {**data, "node_id": arguments.node_id}


def only_what_has_changed(server: AdapterServer) -> None:
    known: dict[str, float] = {}

    @around("read_opcua_node")
    async def nearly_as_before(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments)
        value, before = data["value"], known.get(arguments.node_id)
        if isinstance(value, float):
            if before is not None and abs(value - before) < 1e-5 * abs(before):
                return {**data, "value": before}
            known[arguments.node_id] = value
        return data

    nearly_as_before(server)


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-01r",
        "modbus",
        "Reads go to the register after the one that was asked for.",
        next_register(_READ_INPUT, _READ_HOLDING),
        "RD-001 RD-002 RD-003 RD-004 RD-005 RD-007",
        "RD-001 RD-002 RD-003 RD-004 RD-007",
    ),
    defect(
        "MU-01s",
        "opcua",
        "Numbers of 16 bits without a sign are read as numbers with one.",
        unsigned_as_signed,
        "RD-001",
    ),
    defect(
        "MU-57d",
        "opcua",
        "A value that has changed by less than a hundred-thousandth is told as before.",
        only_what_has_changed,
        "RD-001",
    ),
    defect(
        "MU-06u", "opcua", "Of a numeric node id the last sixteen bits count.", node_id_of_the_lowest_bits, "RD-001"
    ),
    defect("MU-05", "modbus", "Whatever unit is asked for, it is unit 1.", always_unit_1, "RD-003"),
    defect(
        "MU-07r",
        "modbus",
        "Holding registers are read with function 4.",
        input_registers_for_holding,
        "RD-001 RD-002 RD-003 RD-004 RD-005 RD-007",
    ),
    defect(
        "MU-35r",
        "modbus",
        "While the device is gone, holding registers are read with the values that were read before.",
        answers_from_memory_when_gone(_READ_HOLDING),
        "RD-004",
    ),
    defect(
        "MU-36r",
        "modbus",
        "Holding registers that are read soon after are answered from memory, as if from the device.",
        answers_twice_from_one_exchange(_READ_HOLDING),
        "RD-001 RD-002 RD-004 RD-005 RD-007",
        "ENV-008 RD-001 RD-002 RD-004 RD-005 RD-007",
    ),
    defect(
        "MU-36s",
        "opcua",
        "A node that is read soon after is answered from memory, as if from the server.",
        answers_twice_from_one_exchange("read_opcua_node"),
        "RD-001 RD-004",
        "ENV-008 RD-001 RD-004",
    ),
    defect("MU-39", "modbus", "An answer with any transaction identifier is accepted.", any_transaction, "RD-005"),
    defect("MU-39s", "modbus", "An answer is what its first segment brings.", first_segment_alone, "RD-004", "RD-001"),
    defect(
        "MU-40r",
        "modbus",
        "Registers that the device did not send are 0.",
        instead_of("protocol_error", lambda arguments: [0] * arguments.count),
        "RD-003 RD-005",
    ),
    defect("MU-41", "modbus", "The two registers of a float are read in two requests.", register_by_register, "RD-007"),
    defect(
        "MU-41r",
        "modbus",
        "Of a long block of registers the second half comes from its first read.",
        long_blocks_remembered,
        "RD-007",
    ),
    defect(
        "MU-42",
        "modbus",
        "Coils are read with the padding of their last byte.",
        whole_bytes_of_bits,
        "RD-001 RD-002 RD-005 RD-006 RD-007",
        "RD-001 RD-002 RD-006 RD-007",
    ),
    defect(
        "MU-42r",
        "modbus",
        "The first bit of each byte is told as its last.",
        first_bit_told_last,
        "RD-001 RD-005 RD-006 RD-007",
        "RD-001 RD-006 RD-007",
    ),
    defect("MU-43", "modbus", "Of 126 registers 125 are read.", capped_at_125, "RD-007", "ERR-001 ERR-002 RD-007"),
    defect("MU-44r", "modbus", "Two registers from 65535 are 65535 and 0.", begins_at_0_again, "RD-007"),
)
