"""Defects of an EtherNet/IP adapter that the checks of the requirement suite notice."""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from functools import partial
from typing import Any

from ...core import AdapterServer, Call
from ..any_protocol import answers_from_memory_when_gone, guard_after_sending
from ..claims import local_time
from ..mutant import Data, Mutant, failing, told
from ..refusals import _end
from .enc import as_zero, by_way_of_float
from .further import (
    altered,
    controls_always,
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

_READ, _WRITE = "read_tag", "write_tag"

_module = partial(module_of, "ethernetip")


def _one_element_more(server: AdapterServer) -> None:
    tools = _module("tools")
    write_service = tools.write_service

    def longer(path: bytes, kind: bytes, contents: Sequence[bytes]) -> bytes:
        more = [bytes(len(contents[0]))] if len(contents) > 1 else []
        request: bytes = write_service(path, kind, [*contents, *more])
        return request

    tools.write_service = longer


def _confirmed_at_once(server: AdapterServer) -> None:
    async def confirmed(self: Any, call: Call, service: Any, target: Any) -> None:
        """Send nothing."""

    _module("tools").Tools._confirmed = confirmed


def _written(arguments: Any) -> Data:
    content = _module("codec").encode(arguments.value, arguments.data_type)
    return {
        "tag_name": arguments.tag_name,
        "type": arguments.data_type,
        "value": arguments.value,
        "raw": content.hex(),
        "status": 0,
    }


def _signed(data: Data) -> Data:
    is_large = data["type"] == "UINT" and data["value"] >= 0x8000
    return {**data, "value": data["value"] - 0x10000} if is_large else data


def _cut_index(name: Any) -> Any:
    """Return a name whose indexes have the last 32 bits of what they had."""
    if not isinstance(name, str):
        return name
    return re.sub(r"(?<=\[)[0-9]+(?=\])", lambda index: str(int(index[0]) % 2**32), name)


def _by_way_of_32_bits(data: Data) -> Data:
    if data["type"] != "LREAL" or data["value"] is None or abs(data["value"]) > 1e38:
        return data
    return {**data, "value": struct.unpack("<f", struct.pack("<f", data["value"]))[0]}


def _beginning(value: Any, kind: str) -> Any:
    return value[:20] if kind == "STRING" and isinstance(value, str) else value


_mutant = partial(declared, "ethernetip")

MUTANTS: tuple[Mutant, ...] = (
    _mutant(
        "MU-14eiw",
        "wr",
        "WR-001 WR-002 WR-003 WR-004 WR-005 WR-006 WR-007 WR-010",
        "WR-001 WR-006 WR-007",
        _confirmed_at_once,
        "EtherNet/IP writes are told and not sent.",
    ),
    _mutant("MU-04eiw", "rd", "RD-001", "RD-001", told(_READ, change=_signed), "A UINT is read with a sign."),
    _mutant(
        "MU-02eiw",
        "wr",
        "WR-002",
        "WR-002",
        _one_element_more,
        "Elements of an array are written with the one that follows them.",
    ),
    _mutant(
        "MU-20eib",
        "wr",
        "WR-004",
        "WR-004",
        guard_after_sending("write_tag_by_alias"),
        "With writes disabled the tag of an alias is written, and the write then denied.",
    ),
    _mutant(
        "MU-08eiw",
        "adr",
        "ADR-003",
        "ADR-003",
        reencoded("ethernetip", lower_half),
        "Of a value that does not fit into a tag of the type INT the lower half is written.",
    ),
    _mutant(
        "MU-06ei",
        "adr",
        "ADR-002",
        "ADR-002",
        altered(_READ, "tag_name", _cut_index),
        "Of the index of an element the last 32 bits count.",
    ),
    _mutant(
        "MU-11ei", "adr", "ADR-004", "ADR-004", reencoded("ethernetip", truth), "The word false is true for a BOOL."
    ),
    _mutant(
        "MU-37ei",
        "con",
        "CON-001",
        "CON-001",
        last_answer(_READ),
        "Of several reads of tags at the same time all are told what the last one has found.",
    ),
    _mutant(
        "MU-41ei",
        "con",
        "CON-004",
        "CON-004",
        merged(_WRITE, lambda asked: asked.tag_name, _written),
        "Of two writes of one tag at the same time only one is sent, and both are told as successes.",
    ),
    _mutant("MU-56ei", "enc", "ENC-004", "ENC-004", told(_READ, change=as_zero), "A tag that is NaN is 0."),
    _mutant(
        "MU-20eic",
        "wr",
        "WR-004",
        "WR-004",
        controls_always("set_plc_time"),
        "The controller's clock is set wherever writes are enabled, whatever the switch for control says.",
    ),
    _mutant(
        "MU-57ei",
        "enc",
        "ENC-003",
        "ENC-003",
        told(_READ, change=_by_way_of_32_bits),
        "An LREAL is read by way of 32 bits.",
    ),
    _mutant(
        "MU-123eil",
        "enc",
        "ENC-006",
        "ENC-006",
        reencoded("ethernetip", _beginning),
        "Of a text the first 20 characters are written, and the whole text is told as written.",
    ),
    _mutant(
        "MU-58ei",
        "enc",
        "ENC-005",
        "ENC-005",
        told(_READ, change=by_way_of_float),
        "A tag of 64 bits above 2^53 is rounded.",
    ),
    _mutant(
        "MU-123ei",
        "enc",
        "ENC-006",
        "ENC-006",
        told(_READ, change=stripped),
        "The text of a tag is read without the spaces around it.",
    ),
    _mutant(
        "MU-124ei",
        "enc",
        "ENC-003 ENC-004 ENC-005 ENC-006 ENC-007",
        "ENC-007",
        local_time,
        "started_at of an EtherNet/IP answer is the local time with a Z behind it.",
    ),
    _mutant(
        "MU-93ei",
        "res",
        "RES-003",
        "MCP-007",
        failing(change=_end),
        "An EtherNet/IP answer that does not belong to its request ends the adapter.",
    ),
    _mutant(
        "MU-35ei",
        "rec",
        "REC-002",
        "REC-002",
        answers_from_memory_when_gone("read_tag"),
        "While the device is gone, a read of a tag succeeds with what was read before.",
    ),
)
