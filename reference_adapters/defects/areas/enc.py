"""Defects that the checks of the area ENC notice."""

from __future__ import annotations

import math
from typing import Any

from ...core import AdapterServer
from ...core import server as core_server
from ...modbus import tools as modbus_tools
from ...mqtt import payload as mqtt_payload
from ...mqtt import sparkplug_tools
from ...mqtt.inbox import Inbox
from ...opcua import tools as opcua_tools
from ...opcua import values as opcua_values
from ..claims import local_time
from ..defect import Change, Data, Defect, defect, told

__all__ = ["DEFECTS"]

_SWAPPED_BYTES: Any = {"ABCD": "BADC", "BADC": "ABCD", "CDAB": "DCBA", "DCBA": "CDAB"}
_SWAPPED_WORDS: Any = {"ABCD": "CDAB", "CDAB": "ABCD", "BADC": "DCBA", "DCBA": "BADC"}
_TYPED = ("read_holding_typed", "read_input_typed")
_HOURS = 9


def words_swapped_in_reads(server: AdapterServer) -> None:
    genuine = modbus_tools.decode

    def decode(registers: list[int], kind: Any, order: Any) -> Any:
        return genuine(registers, kind, _SWAPPED_WORDS[order] if len(registers) == 2 else order)

    modbus_tools.decode = decode


def bytes_swapped(server: AdapterServer) -> None:
    decode, encode = modbus_tools.decode, modbus_tools.encode
    modbus_tools.decode = lambda registers, kind, order: decode(registers, kind, _SWAPPED_BYTES[order])
    modbus_tools.encode = lambda value, kind, order: encode(value, kind, _SWAPPED_BYTES[order])


def _typed(change: Any) -> Change:
    return told(*_TYPED, change=change)


def _rounded(data: Data) -> Data:
    if isinstance(data["value"], float):
        data["value"] = round(data["value"], 2)
    return data


def _nodes(change: Any) -> Change:
    return told("read_opcua_node", change=change)


def _as_null(data: Data) -> Data:
    return {**data, "special": None}


def as_zero(data: Data) -> Data:
    return {**data, "special": None, "value": 0.0} if data["special"] else data


def bare_nan(server: AdapterServer) -> None:
    core_server._to_json = core_server.json.JSONEncoder(ensure_ascii=False, separators=(",", ":")).encode

    def bare(data: Data) -> Data:
        return {**data, "value": math.nan, "special": None} if data["special"] == "NaN" else data

    _typed(bare)(server)


def by_way_of_float(data: Data) -> Data:
    if isinstance(data["value"], str) and data["value"].lstrip("-").isdecimal():
        data["value"] = int(float(data["value"]))
    return data


def metrics_by_way_of_float(server: AdapterServer) -> None:
    def rounded(number: Any) -> Any:
        return None if number is None else int(float(number))

    mqtt_payload.exact_in_json = rounded


def metrics_without_special(server: AdapterServer) -> None:
    genuine = sparkplug_tools.decode

    def decode(data: bytes, *births: Any) -> Any:
        payload = genuine(data, *births)
        for metric in payload.metrics:
            metric["special"] = None
        return payload

    sparkplug_tools.decode = decode


def binary_is_lost(server: AdapterServer) -> None:
    genuine = Inbox.add

    def add(self: Inbox, message: Any) -> None:
        try:
            message.payload.decode()
        except UnicodeDecodeError:
            return
        genuine(self, message)

    Inbox.add = add


def ascii_texts(server: AdapterServer) -> None:
    def cleaner(call: Any, pointer: str) -> Any:
        return lambda text: (text or "").encode("ascii", "replace").decode()

    opcua_tools.cleaner = cleaner


def latin_identification(server: AdapterServer) -> None:
    genuine = modbus_tools.device_text

    def text(call: Any, pointer: str, raw: Any) -> str:
        return genuine(call, pointer, raw.decode("latin-1") if isinstance(raw, bytes) else raw)

    modbus_tools.device_text = text


def local_timestamps(server: AdapterServer) -> None:
    genuine = opcua_values.timestamp

    def timestamp(moment: Any, **how: Any) -> Any:
        stated = genuine(moment, **how)
        if stated is None or not stated.startswith("2"):
            return stated
        return f"{stated[:11]}{(int(stated[11:13]) + _HOURS) % 24:02}{stated[13:]}"

    opcua_tools.timestamp = opcua_values.timestamp = timestamp


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-03",
        "modbus",
        "The words of numbers of 32 bits are swapped when they are read.",
        words_swapped_in_reads,
        "ENC-001 ENC-003 ENC-004",
    ),
    defect(
        "MU-04e",
        "modbus",
        "The bytes of every register of a number are swapped, in reads and writes alike.",
        bytes_swapped,
        "ENC-001 ENC-003 ENC-004 ENC-005",
    ),
    defect("MU-55", "modbus", "NaN is in the JSON as a word of its own.", bare_nan, "ENC-004", "ENV-003"),
    defect("MU-56", "modbus", "NaN is null, and nothing says that it was NaN.", _typed(_as_null), "ENC-004"),
    defect("MU-56o", "opcua", "NaN is 0.", _nodes(as_zero), "ENC-004"),
    defect(
        "MU-56q",
        "mqtt",
        "A metric that is NaN is null, and nothing says that it was NaN.",
        metrics_without_special,
        "ENC-004",
    ),
    defect(
        "MU-57e", "modbus", "Numbers in registers are rounded to two decimals.", _typed(_rounded), "ENC-001 ENC-003"
    ),
    defect(
        "MU-57o",
        "opcua",
        "Values of nodes are rounded to two decimals.",
        _nodes(_rounded),
        "ENC-003 ENC-004",
        "ENC-003",
    ),
    defect("MU-58", "modbus", "Counters above 2^53 are rounded.", _typed(by_way_of_float), "ENC-001 ENC-005"),
    defect("MU-58o", "opcua", "Whole numbers of nodes above 2^53 are rounded.", _nodes(by_way_of_float), "ENC-005"),
    defect("MU-58q", "mqtt", "Metrics above 2^53 are rounded.", metrics_by_way_of_float, "ENC-005"),
    defect("MU-123", "mqtt", "Messages that are no text are lost.", binary_is_lost, "ENC-006"),
    defect("MU-123o", "opcua", "Characters beyond ASCII become question marks.", ascii_texts, "ENC-006"),
    defect("MU-123m", "modbus", "Texts of the identification are read as Latin-1.", latin_identification, "ENC-006"),
    defect(
        "MU-124e",
        "modbus",
        "started_at is the local time with a Z behind it.",
        local_time,
        "ENC-001 ENC-003 ENC-004 ENC-005 ENC-006 ENC-007",
        "ENC-007",
    ),
    defect("MU-124o", "opcua", "Timestamps are the local time with a Z behind them.", local_timestamps, "ENC-007"),
)
