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
from .mutant import Bend, Data, Handler, Mutant, each, failing, succeeding, wrap

__all__ = ["MUTANTS"]

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


def begins_at_0_again(server: AdapterServer) -> None:
    def wrapping(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            beyond = arguments.address + arguments.count > _ADDRESSES
            data: Data = await genuine(call, arguments.model_copy(update={"address": 0}) if beyond else arguments)
            return {**data, "address": arguments.address}

        return handler

    wrap(server, _READ_HOLDING, wrapping, model=Wrapping)


def instead_of(code: str, values: Any) -> Bend:
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


def texts_are_true(server: AdapterServer) -> None:
    def guessing(genuine: Handler) -> Handler:
        async def handler(call: Call, arguments: Any) -> Data:
            if arguments.value == "false":
                arguments = arguments.model_copy(update={"value": bool(arguments.value)})
            data: Data = await genuine(call, arguments)
            return data

        return handler

    each("write_opcua_node", change=guessing)(server)


def bad_is_good(server: AdapterServer) -> None:
    genuine = opcua_tools.quality

    def quality(status: ua.StatusCode) -> str:
        return "good" if status.name == "BadSensorFailure" else genuine(status)

    opcua_tools.quality = quality


def first_page(server: AdapterServer) -> None:
    async def nothing_follows(services: Services, points: list[bytes]) -> list[ua.BrowseResult]:
        return [ua.BrowseResult() for _ in points]

    Services._browse_next = nothing_follows


MUTANTS = (
    Mutant(
        id="MU-10",
        protocol="modbus",
        sentence="40.7 is written as 40.",
        bend=cuts_fractions_off,
        items="FM2",
        requirements="ADR-004",
    ),
    Mutant(
        id="MU-11",
        protocol="opcua",
        sentence="The text false is written as true.",
        bend=texts_are_true,
        items="FO2",
        requirements="ADR-004",
    ),
    Mutant(
        id="MU-40",
        protocol="modbus",
        sentence="Registers that the device did not send are 0.",
        bend=instead_of("protocol_error", lambda arguments: [0] * arguments.count),
        items="FM1",
        requirements="RD-005",
    ),
    Mutant(
        id="MU-44",
        protocol="modbus",
        sentence="Two registers from 65535 are 65535 and 0.",
        bend=begins_at_0_again,
        items="FM1",
        requirements="RD-007",
    ),
    Mutant(
        id="MU-46",
        protocol="modbus",
        sentence="A busy device is a success without data.",
        bend=instead_of("device_busy", lambda arguments: []),
        items="FM1",
        requirements="ERR-002",
    ),
    Mutant(
        id="MU-68",
        protocol="mqtt",
        sentence="A topic may hold U+0000.",
        bend=null_in_topics,
        items="FQ1",
        requirements="ADR-006",
    ),
    Mutant(
        id="MU-81",
        protocol="opcua",
        sentence="A value with a Bad status is a value.",
        bend=bad_is_good,
        items="FO1",
        requirements="OUA-002",
    ),
    Mutant(
        id="MU-84",
        protocol="opcua",
        sentence="Of a long list of nodes there is the first page.",
        bend=first_page,
        items="O2",
        requirements="OUA-006",
    ),
    Mutant(
        id="MU-93",
        protocol="modbus",
        sentence="A frame that is no frame ends the process.",
        bend=failing(_READ_HOLDING, change=_end),
        items="FM1",
        requirements="MCP-007",
    ),
)
