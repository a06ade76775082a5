"""Defects of an S7 adapter that the checks of the requirement suite notice."""

from __future__ import annotations

from functools import partial
from typing import Any

from ...core import AdapterServer, Call
from ..any_protocol import answers_from_memory_when_gone, guard_after_sending
from ..claims import local_time
from ..defect import Data, Defect, defect, failing, told
from ..refusals import _end
from .enc import as_zero, by_way_of_float
from .further import (
    beginning,
    controls_always,
    cut_off,
    last_answer,
    lower_half,
    merged,
    module_of,
    reencoded,
    stripped,
    truth,
)

__all__ = ["DEFECTS"]

_READ, _WRITE = "read_db_typed", "write_db"
_BLOCK_BITS = 16

_module = partial(module_of, "s7")


def _four_bytes_for_an_int(server: AdapterServer) -> None:
    tools = _module("tools")
    encode = tools.encode
    tools.encode = lambda value, kind, *rest: encode(value, kind, *rest) + (bytes(2) if kind == "INT" else b"")


def _confirmed_at_once(server: AdapterServer) -> None:
    async def confirmed(self: Any, call: Call, *arguments: Any, **more: Any) -> None:
        """Send nothing."""

    _module("tools").Tools._write = confirmed


def _written(arguments: Any) -> Data:
    content = _module("codec").encode(arguments.value, arguments.data_type)
    return {
        "start": arguments.start_offset,
        "type": arguments.data_type,
        "value": arguments.value,
        "raw": content.hex(),
    }


def _signed(data: Data) -> Data:
    return {**data, "value": data["value"] - 0x10000} if data["type"] == "WORD" else data


def _four_digits(value: Any, kind: str) -> Any:
    return float(f"{value:.4g}") if kind == "REAL" and isinstance(value, float) else value


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-14kw",
        "s7",
        "S7 writes are told and not sent.",
        _confirmed_at_once,
        "WR-001 WR-002 WR-003 WR-004 WR-005 WR-006 WR-007 WR-010",
        "WR-001 WR-006 WR-007 WR-011",
    ),
    defect("MU-04kw", "s7", "A WORD is read with a sign.", told(_READ, change=_signed), "RD-001"),
    defect("MU-02k", "s7", "An INT is written with the two bytes that follow it.", _four_bytes_for_an_int, "WR-002"),
    defect(
        "MU-20kb",
        "s7",
        "With writes disabled a flag is written, and then denied.",
        guard_after_sending("write_marker"),
        "WR-004",
    ),
    defect(
        "MU-08kw",
        "s7",
        "Of a value that does not fit into an INT the lower half is written.",
        reencoded("s7", lower_half),
        "ADR-003",
    ),
    defect("MU-11k", "s7", "The word false is true for a bit.", reencoded("s7", truth), "ADR-004"),
    defect(
        "MU-06k",
        "s7",
        "Of the number of a data block the last 16 bits count.",
        cut_off(_WRITE, "db_number", _BLOCK_BITS),
        "ADR-002",
    ),
    defect(
        "MU-37k",
        "s7",
        "Of several S7 reads at the same time all are told what the last one has found.",
        last_answer(_READ),
        "CON-001",
    ),
    defect(
        "MU-41k",
        "s7",
        "Of two S7 writes at the same time only one is sent, and both are told as successes.",
        merged(_WRITE, lambda asked: (asked.db_number, asked.start_offset), _written),
        "CON-004",
    ),
    defect("MU-56k", "s7", "A REAL that is NaN is 0.", told(_READ, change=as_zero), "ENC-004"),
    defect(
        "MU-20kc",
        "s7",
        "The CPU is started and stopped wherever writes are enabled, whatever the switch for control says.",
        controls_always("set_cpu_state"),
        "WR-004",
    ),
    defect("MU-57k", "s7", "Of a REAL that is written four digits are kept.", reencoded("s7", _four_digits), "ENC-003"),
    defect(
        "MU-123kl",
        "s7",
        "Of the text of a STRING the first 20 characters are read.",
        told(_READ, change=beginning),
        "ENC-006",
    ),
    defect("MU-58k", "s7", "A LINT above 2^53 is rounded.", told(_READ, change=by_way_of_float), "ENC-005"),
    defect("MU-123k", "s7", "A STRING is read without the spaces around it.", told(_READ, change=stripped), "ENC-006"),
    defect(
        "MU-124k",
        "s7",
        "started_at of an S7 answer is the local time with a Z behind it.",
        local_time,
        "ENC-003 ENC-004 ENC-005 ENC-006 ENC-007",
        "ENC-007",
    ),
    defect(
        "MU-93k",
        "s7",
        "An S7 answer that does not belong to its request ends the adapter.",
        failing(change=_end),
        "RES-003",
        "MCP-007",
    ),
    defect(
        "MU-35k",
        "s7",
        "While the device is gone, a read of a value of a data block succeeds with what was read before.",
        answers_from_memory_when_gone("read_db_typed"),
        "REC-002",
    ),
)
