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
from ..defect import Data, Defect, defect, failing, told
from ..refusals import _end
from .enc import as_zero, by_way_of_float
from .further import (
    altered,
    controls_always,
    last_answer,
    lower_half,
    merged,
    module_of,
    reencoded,
    stripped,
    truth,
)

__all__ = ["DEFECTS"]

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


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-14eiw",
        "ethernetip",
        "EtherNet/IP writes are told and not sent.",
        _confirmed_at_once,
        "WR-001 WR-002 WR-003 WR-004 WR-005 WR-006 WR-007 WR-010",
        "WR-001 WR-006 WR-007",
    ),
    defect("MU-04eiw", "ethernetip", "A UINT is read with a sign.", told(_READ, change=_signed), "RD-001"),
    defect(
        "MU-02eiw",
        "ethernetip",
        "Elements of an array are written with the one that follows them.",
        _one_element_more,
        "WR-002",
    ),
    defect(
        "MU-20eib",
        "ethernetip",
        "With writes disabled the tag of an alias is written, and the write then denied.",
        guard_after_sending("write_tag_by_alias"),
        "WR-004",
    ),
    defect(
        "MU-08eiw",
        "ethernetip",
        "Of a value that does not fit into a tag of the type INT the lower half is written.",
        reencoded("ethernetip", lower_half),
        "ADR-003",
    ),
    defect(
        "MU-06ei",
        "ethernetip",
        "Of the index of an element the last 32 bits count.",
        altered(_READ, "tag_name", _cut_index),
        "ADR-002",
    ),
    defect("MU-11ei", "ethernetip", "The word false is true for a BOOL.", reencoded("ethernetip", truth), "ADR-004"),
    defect(
        "MU-37ei",
        "ethernetip",
        "Of several reads of tags at the same time all are told what the last one has found.",
        last_answer(_READ),
        "CON-001",
    ),
    defect(
        "MU-41ei",
        "ethernetip",
        "Of two writes of one tag at the same time only one is sent, and both are told as successes.",
        merged(_WRITE, lambda asked: asked.tag_name, _written),
        "CON-004",
    ),
    defect("MU-56ei", "ethernetip", "A tag that is NaN is 0.", told(_READ, change=as_zero), "ENC-004"),
    defect(
        "MU-20eic",
        "ethernetip",
        "The controller's clock is set wherever writes are enabled, whatever the switch for control says.",
        controls_always("set_plc_time"),
        "WR-004",
    ),
    defect(
        "MU-57ei",
        "ethernetip",
        "An LREAL is read by way of 32 bits.",
        told(_READ, change=_by_way_of_32_bits),
        "ENC-003",
    ),
    defect(
        "MU-123eil",
        "ethernetip",
        "Of a text the first 20 characters are written, and the whole text is told as written.",
        reencoded("ethernetip", _beginning),
        "ENC-006",
    ),
    defect(
        "MU-58ei",
        "ethernetip",
        "A tag of 64 bits above 2^53 is rounded.",
        told(_READ, change=by_way_of_float),
        "ENC-005",
    ),
    defect(
        "MU-123ei",
        "ethernetip",
        "The text of a tag is read without the spaces around it.",
        told(_READ, change=stripped),
        "ENC-006",
    ),
    defect(
        "MU-124ei",
        "ethernetip",
        "started_at of an EtherNet/IP answer is the local time with a Z behind it.",
        local_time,
        "ENC-003 ENC-004 ENC-005 ENC-006 ENC-007",
        "ENC-007",
    ),
    defect(
        "MU-93ei",
        "ethernetip",
        "An EtherNet/IP answer that does not belong to its request ends the adapter.",
        failing(change=_end),
        "RES-003",
        "MCP-007",
    ),
    defect(
        "MU-35ei",
        "ethernetip",
        "While the device is gone, a read of a tag succeeds with what was read before.",
        answers_from_memory_when_gone("read_tag"),
        "REC-002",
    ),
)
