"""Defects of adapters for the further protocols, S7 and BACnet, that the checks of several areas notice.

The libraries of these adapters are extras: their modules are imported when a defect is built in, not when the table is read.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable
from importlib import import_module
from typing import Any

from pydantic import create_model, field_validator

from ...core import AdapterServer, Call
from ..any_protocol import guard_after_sending
from ..claims import local_time
from ..mutant import Bend, Data, Handler, Mutant, each, failing, on, told, wrap
from ..refusals import _end

__all__ = ["MUTANTS"]

_READS = {"s7": "read_db_typed", "bacnet": "read_property"}
_WRITES = {"s7": "write_db", "bacnet": "write_property"}
_INSTANCE_BITS, _BLOCK_BITS = 22, 16


def _module(name: str) -> Any:
    return import_module(f"...{name}", __package__)


# -- any of them --------------------------------------------------------------------------------------------


def _last_answer(tool: str) -> Bend:
    """Return the defect that of several calls at the same time all are told what the last of them has found."""

    def bend(server: AdapterServer) -> None:
        last: Data = {}

        def shared(genuine: Handler) -> Handler:
            async def handler(call: Call, arguments: Any) -> Data:
                last.update(await genuine(call, arguments))
                await asyncio.sleep(0.02)
                return dict(last)

            return handler

        each(tool, change=shared)(server)

    return bend


def _merged(tool: str, target: Callable[[Any], Hashable], answer: Callable[[Any], Data]) -> Bend:
    """Return the defect that of several writes to one target at the same time only the last is sent, and all are told as successes."""

    def bend(server: AdapterServer) -> None:
        waiting: dict[Hashable, int] = {}

        def merging(genuine: Handler) -> Handler:
            async def handler(call: Call, arguments: Any) -> Data:
                place = target(arguments)
                waiting[place] = mine = waiting.get(place, 0) + 1
                await asyncio.sleep(0.02)
                if waiting[place] != mine:
                    return answer(arguments)
                data: Data = await genuine(call, arguments)
                return data

            return handler

        each(tool, change=merging)(server)

    return bend


def _cut_off(tool: str, argument: str, bits: int) -> Bend:
    """Return the defect that of a whole number of any size only the last bits count."""

    def masked(cls: type, value: Any) -> Any:
        return value & (1 << bits) - 1 if type(value) is int else value

    def bend(server: AdapterServer) -> None:
        check = {"cut": field_validator(argument, mode="before")(classmethod(masked))}
        genuine = server._tools[tool].model
        wrap(
            server,
            tool,
            lambda handler: handler,
            model=create_model(genuine.__name__, __base__=genuine, __validators__=check),
        )

    return bend


def _as_zero(data: Data) -> Data:
    return {**data, "special": None, "value": 0.0} if data["special"] else data


def _by_way_of_float(data: Data) -> Data:
    if isinstance(data["value"], str) and data["value"].lstrip("-").isdecimal():
        data["value"] = int(float(data["value"]))
    return data


def _stripped(data: Data) -> Data:
    return {**data, "value": data["value"].strip()} if isinstance(data["value"], str) else data


def _signed(data: Data) -> Data:
    return {**data, "value": data["value"] - 0x10000} if data["type"] == "WORD" else data


def _positive(data: Data) -> Data:
    return {**data, "value": abs(data["value"])} if data["type"] == "real" else data


# -- S7 -----------------------------------------------------------------------------------------------------


def _four_bytes_for_an_int(server: AdapterServer) -> None:
    tools = _module("s7.tools")
    encode = tools.encode
    tools.encode = lambda value, kind, *rest: encode(value, kind, *rest) + (bytes(2) if kind == "INT" else b"")


def _lower_half(server: AdapterServer) -> None:
    tools = _module("s7.tools")
    encode = tools.encode

    def fitting(value: Any, kind: Any, *rest: Any) -> bytes:
        fits = (value + 0x8000) % 0x10000 - 0x8000 if kind == "INT" and type(value) is int else value
        content: bytes = encode(fits, kind, *rest)
        return content

    tools.encode = fitting


def _words_are_true(server: AdapterServer) -> None:
    tools = _module("s7.tools")
    encode = tools.encode

    def lenient(value: Any, kind: Any, *rest: Any) -> bytes:
        content: bytes = encode(bool(value) if kind == "BOOL" else value, kind, *rest)
        return content

    tools.encode = lenient


def _confirmed_at_once(server: AdapterServer) -> None:
    async def confirmed(self: Any, call: Call, variables: Any, contents: Any) -> None:
        """Send nothing."""

    _module("s7.tools").Tools._write = confirmed


def _written(arguments: Any) -> Data:
    content = _module("s7.codec").encode(arguments.value, arguments.data_type)
    return {
        "start": arguments.start_offset,
        "type": arguments.data_type,
        "value": arguments.value,
        "raw": content.hex(),
    }


# -- BACnet -------------------------------------------------------------------------------------------------


def _at_the_lowest_priority(server: AdapterServer) -> None:
    tools = _module("bacnet.tools").Tools
    genuine = tools._write

    async def lowered(self: Any, call: Call, asked: Any) -> Data:
        data: Data = await genuine(self, call, asked.model_copy(update={"priority": 16}))
        return data

    tools._write = lowered


def _at_least_zero(server: AdapterServer) -> None:
    tools = _module("bacnet.tools")
    encoded = tools.encoded

    def raised(kind: Any, number: Any, index: Any, value: Any) -> Any:
        is_state = str(kind).startswith("multi-state") and type(value) is int
        return encoded(kind, number, index, max(value, 1) if is_state else value)

    tools.encoded = raised


def _numbers_from_texts(server: AdapterServer) -> None:
    tools = _module("bacnet.tools")
    encoded = tools.encoded

    def lenient(kind: Any, number: Any, index: Any, value: Any) -> Any:
        is_number = str(kind).startswith("analog") and isinstance(value, str) and value[:1].isdecimal()
        return encoded(kind, number, index, float(value) if is_number else value)

    tools.encoded = lenient


def _held(arguments: Any) -> Data:
    told_of = ("device_id", "object_type", "object_instance", "property_id", "value")
    return {
        **arguments.model_dump(include=set(told_of)),
        "present_value": arguments.value,
        "priority": None,
        "winning_priority": None,
    }


def _mutant(id: str, protocol: str, areas: str, rows: str, requirements: str, bend: Bend, sentence: str) -> Mutant:
    return Mutant(
        id=id,
        protocol=protocol,
        sentence=sentence,
        bend=bend,
        items=on(protocol, rows),
        requirements=requirements,
        areas=areas,
    )


_S7 = (
    (
        "MU-14kw",
        "wr",
        "WR-001 WR-002 WR-003 WR-004 WR-005 WR-010",
        "WR-001",
        _confirmed_at_once,
        "S7 writes are told and not sent.",
    ),
    ("MU-04kw", "rd", "RD-001", "RD-001", told(_READS["s7"], change=_signed), "A WORD is read with a sign."),
    (
        "MU-02k",
        "wr",
        "WR-002",
        "WR-002",
        _four_bytes_for_an_int,
        "An INT is written with the two bytes that follow it.",
    ),
    (
        "MU-20kb",
        "wr",
        "WR-004",
        "WR-004",
        guard_after_sending("write_marker"),
        "With writes disabled a flag is written, and then denied.",
    ),
    (
        "MU-08kw",
        "adr",
        "ADR-003",
        "ADR-003",
        _lower_half,
        "Of a value that does not fit into an INT the lower half is written.",
    ),
    ("MU-11k", "adr", "ADR-004", "ADR-004", _words_are_true, "The word false is true for a bit."),
    (
        "MU-06k",
        "adr",
        "ADR-002",
        "ADR-002",
        _cut_off(_WRITES["s7"], "db_number", _BLOCK_BITS),
        "Of the number of a data block the last 16 bits count.",
    ),
    (
        "MU-37k",
        "con",
        "CON-001",
        "CON-001",
        _last_answer(_READS["s7"]),
        "Of several S7 reads at the same time all are told what the last one has found.",
    ),
    (
        "MU-41k",
        "con",
        "CON-004",
        "CON-004",
        _merged(_WRITES["s7"], lambda asked: (asked.db_number, asked.start_offset), _written),
        "Of two S7 writes at the same time only one is sent, and both are told as successes.",
    ),
    ("MU-56k", "enc", "ENC-004", "ENC-004", told(_READS["s7"], change=_as_zero), "A REAL that is NaN is 0."),
    (
        "MU-58k",
        "enc",
        "ENC-005",
        "ENC-005",
        told(_READS["s7"], change=_by_way_of_float),
        "A LINT above 2^53 is rounded.",
    ),
    (
        "MU-123k",
        "enc",
        "ENC-006",
        "ENC-006",
        told(_READS["s7"], change=_stripped),
        "A STRING is read without the spaces around it.",
    ),
    (
        "MU-124k",
        "enc",
        "ENC-004 ENC-005 ENC-006 ENC-007",
        "ENC-007",
        local_time,
        "started_at of an S7 answer is the local time with a Z behind it.",
    ),
    (
        "MU-93k",
        "res",
        "RES-003",
        "MCP-007",
        failing(change=_end),
        "An S7 answer that does not belong to its request ends the adapter.",
    ),
)

_BACNET = (
    (
        "MU-02bw",
        "wr",
        "WR-001 WR-002",
        "WR-001 WR-002",
        _at_the_lowest_priority,
        "A BACnet write by an alias goes to priority 16, whichever the alias has.",
    ),
    (
        "MU-04bac",
        "rd",
        "RD-001",
        "RD-001",
        told(_READS["bacnet"], change=_positive),
        "A REAL is read without its sign.",
    ),
    (
        "MU-20bw",
        "wr",
        "WR-004",
        "WR-004",
        guard_after_sending("write_object_by_alias"),
        "With writes disabled an alias is written, and then denied.",
    ),
    (
        "MU-09bac",
        "adr",
        "ADR-003",
        "ADR-003",
        _at_least_zero,
        "A state below the first one is written as the first one.",
    ),
    (
        "MU-12bac",
        "adr",
        "ADR-004",
        "ADR-004",
        _numbers_from_texts,
        "A text with a number in it is written as the number.",
    ),
    (
        "MU-06bac",
        "adr",
        "ADR-002",
        "ADR-002",
        _cut_off(_WRITES["bacnet"], "object_instance", _INSTANCE_BITS),
        "Of an instance the last 22 bits count.",
    ),
    (
        "MU-37bac",
        "con",
        "CON-001",
        "CON-001",
        _last_answer(_READS["bacnet"]),
        "Of several BACnet reads at the same time all are told what the last one has found.",
    ),
    (
        "MU-41bac",
        "con",
        "CON-004",
        "CON-004",
        _merged(_WRITES["bacnet"], lambda asked: (asked.object_type, asked.object_instance), _held),
        "Of two BACnet writes at the same time only one is sent, and both are told as successes.",
    ),
    (
        "MU-56bac",
        "enc",
        "ENC-004",
        "ENC-004",
        told(_READS["bacnet"], change=_as_zero),
        "A present value that is NaN is 0.",
    ),
    (
        "MU-58bac",
        "enc",
        "ENC-005",
        "ENC-005",
        told(_READS["bacnet"], change=_by_way_of_float),
        "An Unsigned above 2^53 is rounded.",
    ),
    (
        "MU-123bac",
        "enc",
        "ENC-006",
        "ENC-006",
        told(_READS["bacnet"], change=_stripped),
        "A character string is read without the spaces around it.",
    ),
    (
        "MU-124bac",
        "enc",
        "ENC-004 ENC-005 ENC-006 ENC-007",
        "ENC-007",
        local_time,
        "started_at of a BACnet answer is the local time with a Z behind it.",
    ),
    (
        "MU-93bac",
        "res",
        "RES-003",
        "MCP-007",
        failing(change=_end),
        "A BACnet answer that cannot be read ends the adapter.",
    ),
)

MUTANTS: tuple[Mutant, ...] = (
    *(_mutant(id, "s7", *rest) for id, *rest in _S7),
    *(_mutant(id, "bacnet", *rest) for id, *rest in _BACNET),
)
