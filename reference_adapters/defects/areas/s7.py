"""Defects of an S7 adapter that the checks of the requirement suite notice."""

from __future__ import annotations

from functools import partial
from typing import Any

from ...core import AdapterServer, Call
from ..any_protocol import answers_from_memory_when_gone, guard_after_sending
from ..claims import local_time
from ..mutant import Data, Mutant, failing, told
from ..refusals import _end
from .enc import as_zero, by_way_of_float
from .further import (
    beginning,
    controls_always,
    cut_off,
    declared,
    last_answer,
    lower_half,
    merged,
    module_of,
    reencoded,
    stripped,
    truth,
)

__all__ = ["MUTANTS"]

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


_mutant = partial(declared, "s7")

MUTANTS: tuple[Mutant, ...] = (
    _mutant(
        "MU-14kw",
        "wr",
        "WR-001 WR-002 WR-003 WR-004 WR-005 WR-006 WR-007 WR-010",
        "WR-001 WR-006 WR-007 WR-011",
        _confirmed_at_once,
        "S7 writes are told and not sent.",
    ),
    _mutant("MU-04kw", "rd", "RD-001", "RD-001", told(_READ, change=_signed), "A WORD is read with a sign."),
    _mutant(
        "MU-02k",
        "wr",
        "WR-002",
        "WR-002",
        _four_bytes_for_an_int,
        "An INT is written with the two bytes that follow it.",
    ),
    _mutant(
        "MU-20kb",
        "wr",
        "WR-004",
        "WR-004",
        guard_after_sending("write_marker"),
        "With writes disabled a flag is written, and then denied.",
    ),
    _mutant(
        "MU-08kw",
        "adr",
        "ADR-003",
        "ADR-003",
        reencoded("s7", lower_half),
        "Of a value that does not fit into an INT the lower half is written.",
    ),
    _mutant("MU-11k", "adr", "ADR-004", "ADR-004", reencoded("s7", truth), "The word false is true for a bit."),
    _mutant(
        "MU-06k",
        "adr",
        "ADR-002",
        "ADR-002",
        cut_off(_WRITE, "db_number", _BLOCK_BITS),
        "Of the number of a data block the last 16 bits count.",
    ),
    _mutant(
        "MU-37k",
        "con",
        "CON-001",
        "CON-001",
        last_answer(_READ),
        "Of several S7 reads at the same time all are told what the last one has found.",
    ),
    _mutant(
        "MU-41k",
        "con",
        "CON-004",
        "CON-004",
        merged(_WRITE, lambda asked: (asked.db_number, asked.start_offset), _written),
        "Of two S7 writes at the same time only one is sent, and both are told as successes.",
    ),
    _mutant("MU-56k", "enc", "ENC-004", "ENC-004", told(_READ, change=as_zero), "A REAL that is NaN is 0."),
    _mutant(
        "MU-20kc",
        "wr",
        "WR-004",
        "WR-004",
        controls_always("set_cpu_state"),
        "The CPU is started and stopped wherever writes are enabled, whatever the switch for control says.",
    ),
    _mutant(
        "MU-57k",
        "enc",
        "ENC-003",
        "ENC-003",
        reencoded("s7", _four_digits),
        "Of a REAL that is written four digits are kept.",
    ),
    _mutant(
        "MU-123kl",
        "enc",
        "ENC-006",
        "ENC-006",
        told(_READ, change=beginning),
        "Of the text of a STRING the first 20 characters are read.",
    ),
    _mutant(
        "MU-58k",
        "enc",
        "ENC-005",
        "ENC-005",
        told(_READ, change=by_way_of_float),
        "A LINT above 2^53 is rounded.",
    ),
    _mutant(
        "MU-123k",
        "enc",
        "ENC-006",
        "ENC-006",
        told(_READ, change=stripped),
        "A STRING is read without the spaces around it.",
    ),
    _mutant(
        "MU-124k",
        "enc",
        "ENC-003 ENC-004 ENC-005 ENC-006 ENC-007",
        "ENC-007",
        local_time,
        "started_at of an S7 answer is the local time with a Z behind it.",
    ),
    _mutant(
        "MU-93k",
        "res",
        "RES-003",
        "MCP-007",
        failing(change=_end),
        "An S7 answer that does not belong to its request ends the adapter.",
    ),
    _mutant(
        "MU-35k",
        "rec",
        "REC-002",
        "REC-002",
        answers_from_memory_when_gone("read_db_typed"),
        "While the device is gone, a read of a value of a data block succeeds with what was read before.",
    ),
)
