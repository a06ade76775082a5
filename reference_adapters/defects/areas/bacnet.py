"""Defects of a BACnet adapter that the checks of the requirement suite notice."""

from __future__ import annotations

from functools import partial
from typing import Any

from ...core import AdapterServer, Call
from ..any_protocol import answers_from_memory_when_gone, guard_after_sending
from ..claims import local_time
from ..defect import Data, Defect, defect, failing, told
from ..refusals import _end
from .enc import as_zero, by_way_of_float
from .further import cut_off, last_answer, merged, module_of, stripped

__all__ = ["DEFECTS"]

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


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-02bw",
        "bacnet",
        "A BACnet write by an alias goes to priority 16, whichever the alias has.",
        _at_the_lowest_priority,
        "WR-001 WR-002",
    ),
    defect("MU-04bac", "bacnet", "A REAL is read without its sign.", told(_READ, change=_positive), "RD-001"),
    defect(
        "MU-20bw",
        "bacnet",
        "With writes disabled an alias is written, and then denied.",
        guard_after_sending("write_object_by_alias"),
        "WR-004 WR-010",
        "ERR-006 WR-004",
    ),
    defect("MU-09bac", "bacnet", "A state below the first one is written as the first one.", _at_least_zero, "ADR-003"),
    defect(
        "MU-11bac", "bacnet", "A text with a number in it is written as the number.", _numbers_from_texts, "ADR-004"
    ),
    defect(
        "MU-06bac",
        "bacnet",
        "Of an instance the last 22 bits count.",
        cut_off(_WRITE, "object_instance", _INSTANCE_BITS),
        "ADR-002",
    ),
    defect(
        "MU-37bac",
        "bacnet",
        "Of several BACnet reads at the same time all are told what the last one has found.",
        last_answer(_READ),
        "CON-001",
    ),
    defect(
        "MU-41bac",
        "bacnet",
        "Of two BACnet writes at the same time only one is sent, and both are told as successes.",
        merged(_WRITE, lambda asked: (asked.object_type, asked.object_instance), _held),
        "CON-004",
    ),
    defect("MU-56bac", "bacnet", "A present value that is NaN is 0.", told(_READ, change=as_zero), "ENC-004"),
    defect("MU-57bac", "bacnet", "A REAL is rounded to one decimal.", told(_READ, change=_one_decimal), "ENC-003"),
    defect("MU-58bac", "bacnet", "An Unsigned above 2^53 is rounded.", told(_READ, change=by_way_of_float), "ENC-005"),
    defect(
        "MU-123b",
        "bacnet",
        "A character string is read without the spaces around it.",
        told(_READ, change=stripped),
        "ENC-006",
    ),
    defect(
        "MU-124b",
        "bacnet",
        "started_at of a BACnet answer is the local time with a Z behind it.",
        local_time,
        "ENC-003 ENC-004 ENC-005 ENC-006 ENC-007",
        "ENC-007",
    ),
    defect(
        "MU-93bac",
        "bacnet",
        "A BACnet answer that cannot be read ends the adapter.",
        failing(change=_end),
        "RES-003",
        "MCP-007",
    ),
    defect(
        "MU-35bac",
        "bacnet",
        "While the device is gone, a read of a property succeeds with what was read before.",
        answers_from_memory_when_gone("read_property", silent=True),
        "REC-002",
    ),
)
