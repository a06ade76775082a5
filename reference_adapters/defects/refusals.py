"""Defects of an adapter that accepts what it has to refuse, or takes a bad answer of its device for a good one."""

from __future__ import annotations

import os
from typing import Any

from asyncua import ua
from pydantic import field_validator, model_validator

from ..core import AdapterError, AdapterServer, Call
from ..modbus.shapes import Registers, WriteRegister
from ..mqtt import tools as mqtt_tools
from ..opcua import tools as opcua_tools
from ..opcua.services import Services
from .defect import Change, Data, Handler, around, defect, failing, succeeding, wrap

__all__ = ["DEFECTS"]

_READ_HOLDING, _WRITE = "read_multiple_holding_registers", "write_register"
_ADDRESSES = 65536


class Truncating(WriteRegister):
    """A register and its value; a fraction is cut off."""

    @field_validator("value", mode="before")
    @classmethod
    def _cut_off(cls, value: Any) -> Any:
        return int(value) if isinstance(value, float) else value


class Wrapping(Registers):
    """A block of registers that may run past the last address."""

    @model_validator(mode="after")
    def _block_exists(self) -> Wrapping:
        return self


def cuts_fractions_off(server: AdapterServer) -> None:
    wrap(server, _WRITE, lambda genuine: genuine, model=Truncating)


@around(_READ_HOLDING, model=Wrapping)
async def begins_at_0_again(genuine: Handler, call: Call, arguments: Any) -> Data:
    beyond = arguments.address + arguments.count > _ADDRESSES
    data = await genuine(call, arguments.model_copy(update={"address": 0}) if beyond else arguments)
    return {**data, "address": arguments.address}


def instead_of(code: str, values: Any) -> Change:
    """Return the defect that reads which fail with this code succeed with other values, made from the arguments."""

    def answer(call: Call, arguments: Any) -> Data:
        found = values(arguments)
        return {"address": arguments.address, "count": len(found), "values": found}

    return succeeding(_READ_HOLDING, code=code, answer=answer)


def _end(call: Call, error: AdapterError) -> Exception | None:
    if error.code == "protocol_error":
        os._exit(1)
    return None


def null_in_topics(server: AdapterServer) -> None:
    genuine = mqtt_tools.check_name
    mqtt_tools.check_name = lambda topic: topic if "\0" in topic else genuine(topic)


@around("write_opcua_node")
async def texts_are_true(genuine: Handler, call: Call, arguments: Any) -> Data:
    if arguments.value == "false":
        arguments = arguments.model_copy(update={"value": bool(arguments.value)})
    data = await genuine(call, arguments)
    return data


def bad_is_good(server: AdapterServer) -> None:
    genuine = opcua_tools.quality

    def quality(status: ua.StatusCode) -> str:
        return "good" if status.name == "BadSensorFailure" else genuine(status)

    opcua_tools.quality = quality


def first_page(server: AdapterServer) -> None:
    async def nothing_follows(services: Services, points: list[bytes]) -> list[ua.BrowseResult]:
        return [ua.BrowseResult() for _ in points]

    Services._browse_next = nothing_follows


DEFECTS = (
    defect("MU-10", "modbus", "40.7 is written as 40.", cuts_fractions_off, "FM2", "ADR-004"),
    defect("MU-11", "opcua", "The text false is written as true.", texts_are_true, "FO2", "ADR-004"),
    defect(
        "MU-40",
        "modbus",
        "Registers that the device did not send are 0.",
        instead_of("protocol_error", lambda arguments: [0] * arguments.count),
        "FM1",
        "RD-005",
    ),
    defect("MU-44", "modbus", "Two registers from 65535 are 65535 and 0.", begins_at_0_again, "FM1", "RD-007"),
    defect(
        "MU-46",
        "modbus",
        "A busy device is a success without data.",
        instead_of("device_busy", lambda arguments: []),
        "FM1",
        "ERR-002",
    ),
    defect("MU-68", "mqtt", "A topic may hold U+0000.", null_in_topics, "FQ1", "ADR-006"),
    defect("MU-81", "opcua", "A value with a Bad status is a value.", bad_is_good, "FO1", "OUA-002"),
    defect("MU-84", "opcua", "Of a long list of nodes there is the first page.", first_page, "O2", "OUA-006"),
    defect(
        "MU-93",
        "modbus",
        "A frame that is no frame ends the process.",
        failing(_READ_HOLDING, change=_end),
        "FM1",
        "MCP-007",
    ),
)
