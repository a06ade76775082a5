"""Defects of a Modbus adapter."""

from __future__ import annotations

from typing import Any

from ..core import AdapterError, AdapterServer, Call
from .mutant import Bend, Data, Handler, Mutant, also, each, failing, told, wrap

__all__ = ["MUTANTS", "heartbeat"]

_READ_INPUT, _READ_HOLDING, _WRITE = "read_input_registers", "read_multiple_holding_registers", "write_register"
_HEARTBEAT = 50


def next_register(*names: str) -> Bend:
    """Return the defect that these tools use the register after the one that was asked for."""

    def shifted(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data = await genuine(call, arguments.model_copy(update={"address": arguments.address + 1}))
            return {**data, "address": arguments.address}

        return handler

    return each(*names, change=shifted)


def next_register_with_invented_trace(server: AdapterServer) -> None:
    def claiming(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            try:
                data: Data = await genuine(call, arguments)
            finally:
                call.trace["address"] = arguments.address
            return data

        return handler

    next_register(_READ_INPUT, _READ_HOLDING)(server)
    each(_READ_INPUT, _READ_HOLDING, change=claiming)(server)


def _swapped(word: int) -> int:
    return (word & 0xFF) << 8 | word >> 8


def swapped_bytes(server: AdapterServer) -> None:
    def writing(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            await genuine(call, arguments.model_copy(update={"value": _swapped(arguments.value)}))
            return {"address": arguments.address, "value": arguments.value}

        return handler

    told(_READ_INPUT, _READ_HOLDING, change=lambda data: {**data, "values": [*map(_swapped, data["values"])]})(server)
    each(_WRITE, change=writing)(server)


def input_registers_for_holding(server: AdapterServer) -> None:
    wrap(server, _READ_HOLDING, lambda genuine: server._tools[_READ_INPUT].handler)


def fitted(server: AdapterServer, value: Any) -> None:
    """Accept any whole number, write what ``value`` makes of it, and say that the number itself was written."""
    tool = server._tools[_WRITE]
    anything = type("Anything", (tool.model,), {"__annotations__": {"value": int}, "__module__": __name__})

    def fitting(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            await genuine(call, tool.model(address=arguments.address, value=value(arguments.value)))
            return {"address": arguments.address, "value": arguments.value}

        return handler

    wrap(server, _WRITE, fitting, model=anything)


def _writes_nothing(claimed: dict[int, int]) -> Any:
    def instead(genuine: Handler) -> Handler:
        async def write(call: Call, arguments: Any) -> Data:
            claimed[arguments.address] = arguments.value
            return {"address": arguments.address, "value": arguments.value}

        return write

    return instead


def write_not_sent(server: AdapterServer) -> None:
    each(_WRITE, change=_writes_nothing({}))(server)


def write_only_remembered(server: AdapterServer) -> None:
    claimed: dict[int, int] = {}

    def remembering(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            data: Data = await genuine(call, arguments)
            data["values"][0] = claimed.get(arguments.address, data["values"][0])
            return data

        return handler

    each(_WRITE, change=_writes_nothing(claimed))(server)
    each(_READ_HOLDING, change=remembering)(server)


async def heartbeat(server: AdapterServer, call: Call) -> None:
    write = server._tools[_WRITE]
    await write.handler(call, write.model(address=_HEARTBEAT, value=1))


def _without_exception_codes(call: Call, error: AdapterError) -> Exception | None:
    return AdapterError("protocol_error", "something went wrong") if "exception_code" in call.trace else None


MUTANTS = (
    Mutant(
        id="MU-01",
        protocol="modbus",
        sentence="Reads go to the register after the one that was asked for.",
        bend=next_register(_READ_INPUT, _READ_HOLDING),
        items="M2 M3 X1 X1p FM1 FX1 S1 S4 S7 S10",
        requirements="ADR-001 CON-004 RD-001",
    ),
    Mutant(
        id="MU-02",
        protocol="modbus",
        sentence="Writes and the reads of holding registers both go to the next register.",
        bend=next_register(_WRITE, _READ_HOLDING),
        items="M3 M4 X2 X2p FM1 FM2 S4",
        requirements="ADR-001 CON-004 RD-001 WR-001 WR-002",
    ),
    Mutant(
        id="MU-04",
        protocol="modbus",
        sentence="The bytes of every register are swapped, in reads and writes alike.",
        bend=swapped_bytes,
        items="M2 M3 M4 X1 X2 X1p X2p FM1 FX1 S1 S4 S7",
        requirements="CON-004 ENC-001 RD-001 WR-001",
    ),
    Mutant(
        id="MU-07",
        protocol="modbus",
        sentence="Holding registers are read with function 4.",
        bend=input_registers_for_holding,
        items="M3 FM1 S4",
        requirements="CON-004 RD-001 RD-002",
    ),
    Mutant(
        id="MU-08",
        protocol="modbus",
        sentence="70000 is written as 4464, and told as a success.",
        bend=lambda server: fitted(server, lambda value: value & 0xFFFF),
        items="FM2",
        requirements="ADR-003",
    ),
    Mutant(
        id="MU-09",
        protocol="modbus",
        sentence="70000 is written as 65535, and told as a success.",
        bend=lambda server: fitted(server, lambda value: min(value, 0xFFFF)),
        items="FM2",
        requirements="ADR-003",
    ),
    Mutant(
        id="MU-14",
        protocol="modbus",
        sentence="A write succeeds, and nothing is sent.",
        bend=write_not_sent,
        items="M3 M4 X2 X2p FM2 S4 S10",
        requirements="WR-001",
    ),
    Mutant(
        id="MU-15",
        protocol="modbus",
        sentence="A write succeeds, nothing is sent, and the value is read back from memory.",
        bend=write_only_remembered,
        items="M3 M4 X2 X2p FM2 S4 S10",
        requirements="RD-001 WR-001",
    ),
    Mutant(
        id="MU-45",
        protocol="modbus",
        sentence="Every exception of the device becomes protocol_error.",
        bend=failing(change=_without_exception_codes),
        items="FM1",
        requirements="ERR-002",
    ),
    Mutant(
        id="MU-53a",
        protocol="modbus",
        sentence="The tool that asks whether the device is reachable writes a heartbeat.",
        bend=also("ping", action=heartbeat),
        items="M1",
        requirements="MCP-008",
    ),
    Mutant(
        id="MU-53b",
        protocol="modbus",
        sentence="The tool that reads input registers writes a heartbeat.",
        bend=also(_READ_INPUT, action=heartbeat),
        items="M2 M4 X1 X1p FX1 S1 S7 S10",
        requirements="MCP-008 WR-004 WR-010",
    ),
    Mutant(
        id="MU-53c",
        protocol="modbus",
        sentence="The tool that reads holding registers writes a heartbeat.",
        bend=also(_READ_HOLDING, action=heartbeat),
        items="M3 M4 FM1 S4",
        requirements="MCP-008 WR-003 WR-004",
    ),
    Mutant(
        id="MU-116",
        protocol="modbus",
        sentence="Reads go to the next register, and meta.trace says that they went to the right one.",
        bend=next_register_with_invented_trace,
        items="M2 M3 M4 X1 X1p FM1 FX1 S1 S4 S7 S10",
        requirements="ADR-001 CON-004 ENV-007 RD-001",
    ),
)
