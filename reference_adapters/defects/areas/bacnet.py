"""Defects of a BACnet adapter that the checks of the requirement suite notice."""

from __future__ import annotations

from functools import partial
from typing import Any

from ...core import AdapterServer, Call
from ..any_protocol import answers_from_memory_when_gone, guard_after_sending
from ..claims import local_time
from ..mutant import Data, Mutant, failing, told
from ..refusals import _end
from .enc import as_zero, by_way_of_float
from .further import cut_off, declared, last_answer, merged, module_of, stripped

__all__ = ["MUTANTS"]

_READ, _WRITE = "read_property", "write_property"
_INSTANCE_BITS = 22

_module = partial(module_of, "bacnet")


def _at_the_lowest_priority(server: AdapterServer) -> None:
    tools = _module("tools").Tools
    genuine = tools._write

    async def lowered(self: Any, call: Call, asked: Any) -> Data:
        data: Data = await genuine(self, call, asked.model_copy(update={"priority": 16}))
        return data

    tools._write = lowered


def _at_least_zero(server: AdapterServer) -> None:
    tools = _module("tools")
    encoded = tools.encoded

    def raised(kind: Any, number: Any, index: Any, value: Any) -> Any:
        is_state = str(kind).startswith("multi-state") and type(value) is int
        return encoded(kind, number, index, max(value, 1) if is_state else value)

    tools.encoded = raised


def _numbers_from_texts(server: AdapterServer) -> None:
    tools = _module("tools")
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


def _one_decimal(data: Data) -> Data:
    return {**data, "value": round(data["value"], 1)} if isinstance(data["value"], float) else data


def _positive(data: Data) -> Data:
    return {**data, "value": abs(data["value"])} if data["type"] == "real" else data


_mutant = partial(declared, "bacnet")

MUTANTS: tuple[Mutant, ...] = (
    _mutant(
        "MU-02bw",
        "wr",
        "WR-001 WR-002",
        "WR-001 WR-002",
        _at_the_lowest_priority,
        "A BACnet write by an alias goes to priority 16, whichever the alias has.",
    ),
    _mutant(
        "MU-04bac",
        "rd",
        "RD-001",
        "RD-001",
        told(_READ, change=_positive),
        "A REAL is read without its sign.",
    ),
    _mutant(
        "MU-20bw",
        "wr",
        "WR-004 WR-010",
        "ERR-006 WR-004",
        guard_after_sending("write_object_by_alias"),
        "With writes disabled an alias is written, and then denied.",
    ),
    _mutant(
        "MU-09bac",
        "adr",
        "ADR-003",
        "ADR-003",
        _at_least_zero,
        "A state below the first one is written as the first one.",
    ),
    _mutant(
        "MU-11bac",
        "adr",
        "ADR-004",
        "ADR-004",
        _numbers_from_texts,
        "A text with a number in it is written as the number.",
    ),
    _mutant(
        "MU-06bac",
        "adr",
        "ADR-002",
        "ADR-002",
        cut_off(_WRITE, "object_instance", _INSTANCE_BITS),
        "Of an instance the last 22 bits count.",
    ),
    _mutant(
        "MU-37bac",
        "con",
        "CON-001",
        "CON-001",
        last_answer(_READ),
        "Of several BACnet reads at the same time all are told what the last one has found.",
    ),
    _mutant(
        "MU-41bac",
        "con",
        "CON-004",
        "CON-004",
        merged(_WRITE, lambda asked: (asked.object_type, asked.object_instance), _held),
        "Of two BACnet writes at the same time only one is sent, and both are told as successes.",
    ),
    _mutant(
        "MU-56bac",
        "enc",
        "ENC-004",
        "ENC-004",
        told(_READ, change=as_zero),
        "A present value that is NaN is 0.",
    ),
    _mutant(
        "MU-57bac",
        "enc",
        "ENC-003",
        "ENC-003",
        told(_READ, change=_one_decimal),
        "A REAL is rounded to one decimal.",
    ),
    _mutant(
        "MU-58bac",
        "enc",
        "ENC-005",
        "ENC-005",
        told(_READ, change=by_way_of_float),
        "An Unsigned above 2^53 is rounded.",
    ),
    _mutant(
        "MU-123b",
        "enc",
        "ENC-006",
        "ENC-006",
        told(_READ, change=stripped),
        "A character string is read without the spaces around it.",
    ),
    _mutant(
        "MU-124b",
        "enc",
        "ENC-003 ENC-004 ENC-005 ENC-006 ENC-007",
        "ENC-007",
        local_time,
        "started_at of a BACnet answer is the local time with a Z behind it.",
    ),
    _mutant(
        "MU-93bac",
        "res",
        "RES-003",
        "MCP-007",
        failing(change=_end),
        "A BACnet answer that cannot be read ends the adapter.",
    ),
    _mutant(
        "MU-35bac",
        "rec",
        "REC-002",
        "REC-002",
        answers_from_memory_when_gone("read_property", silent=True),
        "While the device is gone, a read of a property succeeds with what was read before.",
    ),
)
