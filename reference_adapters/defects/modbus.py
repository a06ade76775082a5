"""Defects of a Modbus adapter."""

from __future__ import annotations

from typing import Any

from ..core import AdapterError, AdapterServer, Call
from .defect import Change, Data, Handler, also, around, defect, failing, told, wrap

__all__ = ["DEFECTS", "heartbeat"]

_READ_INPUT, _READ_HOLDING, _WRITE = "read_input_registers", "read_multiple_holding_registers", "write_register"
_HEARTBEAT = 50


def next_register(*names: str) -> Change:
    """Return the defect that these tools use the register after the one that was asked for."""

    @around(*names)
    async def shifted(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments.model_copy(update={"address": arguments.address + 1}))
        return {**data, "address": arguments.address}

    return shifted


def next_register_with_invented_trace(server: AdapterServer) -> None:
    @around(_READ_INPUT, _READ_HOLDING)
    async def claiming(genuine: Handler, call: Call, arguments: Any) -> Data:
        try:
            data = await genuine(call, arguments)
        finally:
            call.trace["address"] = arguments.address
        return data

    next_register(_READ_INPUT, _READ_HOLDING)(server)
    claiming(server)


def _swapped(word: int) -> int:
    return (word & 0xFF) << 8 | word >> 8


def swapped_bytes(server: AdapterServer) -> None:
    @around(_WRITE)
    async def writing(genuine: Handler, call: Call, arguments: Any) -> Data:
        await genuine(call, arguments.model_copy(update={"value": _swapped(arguments.value)}))
        return {"address": arguments.address, "value": arguments.value}

    told(_READ_INPUT, _READ_HOLDING, change=lambda data: {**data, "values": [*map(_swapped, data["values"])]})(server)
    writing(server)


def input_registers_for_holding(server: AdapterServer) -> None:
    wrap(server, _READ_HOLDING, lambda genuine: server._tools[_READ_INPUT].handler)


def fitted(server: AdapterServer, value: Any) -> None:
    """Accept any whole number, write what ``value`` makes of it, and say that the number itself was written."""
    tool = server._tools[_WRITE]
    anything = type("Anything", (tool.model,), {"__annotations__": {"value": int}, "__module__": __name__})

    @around(_WRITE, model=anything)
    async def fitting(genuine: Handler, call: Call, arguments: Any) -> Data:
        await genuine(call, tool.model(address=arguments.address, value=value(arguments.value)))
        return {"address": arguments.address, "value": arguments.value}

    fitting(server)


def _writes_nothing(claimed: dict[int, int]) -> Change:
    @around(_WRITE)
    async def instead(genuine: Handler, call: Call, arguments: Any) -> Data:
        claimed[arguments.address] = arguments.value
        return {"address": arguments.address, "value": arguments.value}

    return instead


write_not_sent = _writes_nothing({})


def write_only_remembered(server: AdapterServer) -> None:
    claimed: dict[int, int] = {}

    @around(_READ_HOLDING)
    async def remembering(genuine: Handler, call: Call, arguments: Any) -> Data:
        data = await genuine(call, arguments)
        data["values"][0] = claimed.get(arguments.address, data["values"][0])
        return data

    _writes_nothing(claimed)(server)
    remembering(server)


async def heartbeat(server: AdapterServer, call: Call) -> None:
    write = server._tools[_WRITE]
    await write.handler(call, write.model(address=_HEARTBEAT, value=1))


def _without_exception_codes(call: Call, error: AdapterError) -> Exception | None:
    return AdapterError("protocol_error", "something went wrong") if "exception_code" in call.trace else None


DEFECTS = (
    defect(
        "MU-01",
        "modbus",
        "Reads go to the register after the one that was asked for.",
        next_register(_READ_INPUT, _READ_HOLDING),
        "M2 M3 X1 X1p FM1 FX1 S1 S4 S7 S10",
        "ADR-001 CON-004 RD-001",
    ),
    defect(
        "MU-02",
        "modbus",
        "Writes and the reads of holding registers both go to the next register.",
        next_register(_WRITE, _READ_HOLDING),
        "M3 M4 X2 X2p FM1 FM2 S4",
        "ADR-001 CON-004 RD-001 WR-001 WR-002",
    ),
    defect(
        "MU-04",
        "modbus",
        "The bytes of every register are swapped, in reads and writes alike.",
        swapped_bytes,
        "M2 M3 M4 X1 X2 X1p X2p FM1 FX1 S1 S4 S7",
        "CON-004 ENC-001 RD-001 WR-001",
    ),
    defect(
        "MU-07",
        "modbus",
        "Holding registers are read with function 4.",
        input_registers_for_holding,
        "M3 FM1 S4",
        "CON-004 RD-001 RD-002",
    ),
    defect(
        "MU-08",
        "modbus",
        "70000 is written as 4464, and told as a success.",
        lambda server: fitted(server, lambda value: value & 0xFFFF),
        "FM2",
        "ADR-003",
    ),
    defect(
        "MU-09",
        "modbus",
        "70000 is written as 65535, and told as a success.",
        lambda server: fitted(server, lambda value: min(value, 0xFFFF)),
        "FM2",
        "ADR-003",
    ),
    defect(
        "MU-14", "modbus", "A write succeeds, and nothing is sent.", write_not_sent, "M3 M4 X2 X2p FM2 S4 S10", "WR-001"
    ),
    defect(
        "MU-15",
        "modbus",
        "A write succeeds, nothing is sent, and the value is read back from memory.",
        write_only_remembered,
        "M3 M4 X2 X2p FM2 S4 S10",
        "RD-001 WR-001",
    ),
    defect(
        "MU-45",
        "modbus",
        "Every exception of the device becomes protocol_error.",
        failing(change=_without_exception_codes),
        "FM1",
        "ERR-002",
    ),
    defect(
        "MU-53a",
        "modbus",
        "The tool that asks whether the device is reachable writes a heartbeat.",
        also("ping", action=heartbeat),
        "M1",
        "MCP-008",
    ),
    defect(
        "MU-53b",
        "modbus",
        "The tool that reads input registers writes a heartbeat.",
        also(_READ_INPUT, action=heartbeat),
        "M2 M4 X1 X1p FX1 S1 S7 S10",
        "MCP-008 WR-004 WR-010",
    ),
    defect(
        "MU-53c",
        "modbus",
        "The tool that reads holding registers writes a heartbeat.",
        also(_READ_HOLDING, action=heartbeat),
        "M3 M4 FM1 S4",
        "MCP-008 WR-003 WR-004",
    ),
    defect(
        "MU-116",
        "modbus",
        "Reads go to the next register, and meta.trace says that they went to the right one.",
        next_register_with_invented_trace,
        "M2 M3 M4 X1 X1p FM1 FX1 S1 S4 S7 S10",
        "ADR-001 CON-004 ENV-007 RD-001",
    ),
)
