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
from ..mutant import Bend, Data, Mutant, told

__all__ = ["MUTANTS"]

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


def _typed(change: Any) -> Bend:
    return told(*_TYPED, change=change)


def _rounded(data: Data) -> Data:
    if isinstance(data["value"], float):
        data["value"] = round(data["value"], 2)
    return data


def _nodes(change: Any) -> Bend:
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


MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        id="MU-03",
        protocol="modbus",
        sentence="The words of numbers of 32 bits are swapped when they are read.",
        bend=words_swapped_in_reads,
        items="ENC-001.modbus ENC-003.modbus ENC-004.modbus",
        requirements="ENC-001 ENC-003 ENC-004",
        areas="enc",
    ),
    Mutant(
        id="MU-04e",
        protocol="modbus",
        sentence="The bytes of every register of a number are swapped, in reads and writes alike.",
        bend=bytes_swapped,
        items="ENC-001.modbus ENC-003.modbus ENC-004.modbus ENC-005.modbus",
        requirements="ENC-001 ENC-003 ENC-004 ENC-005",
        areas="enc",
    ),
    Mutant(
        id="MU-55",
        protocol="modbus",
        sentence="NaN is in the JSON as a word of its own.",
        bend=bare_nan,
        items="ENC-004.modbus",
        requirements="ENV-003",
        areas="enc",
    ),
    Mutant(
        id="MU-56",
        protocol="modbus",
        sentence="NaN is null, and nothing says that it was NaN.",
        bend=_typed(_as_null),
        items="ENC-004.modbus",
        requirements="ENC-004",
        areas="enc",
    ),
    Mutant(
        id="MU-56o",
        protocol="opcua",
        sentence="NaN is 0.",
        bend=_nodes(as_zero),
        items="ENC-004.opcua",
        requirements="ENC-004",
        areas="enc",
    ),
    Mutant(
        id="MU-56q",
        protocol="mqtt",
        sentence="A metric that is NaN is null, and nothing says that it was NaN.",
        bend=metrics_without_special,
        items="ENC-004.mqtt",
        requirements="ENC-004",
        areas="enc",
    ),
    Mutant(
        id="MU-57e",
        protocol="modbus",
        sentence="Numbers in registers are rounded to two decimals.",
        bend=_typed(_rounded),
        items="ENC-001.modbus ENC-003.modbus",
        requirements="ENC-001 ENC-003",
        areas="enc",
    ),
    Mutant(
        id="MU-57o",
        protocol="opcua",
        sentence="Values of nodes are rounded to two decimals.",
        bend=_nodes(_rounded),
        items="ENC-003.opcua ENC-004.opcua",
        requirements="ENC-003",
        areas="enc",
    ),
    Mutant(
        id="MU-58",
        protocol="modbus",
        sentence="Counters above 2^53 are rounded.",
        bend=_typed(by_way_of_float),
        items="ENC-001.modbus ENC-005.modbus",
        requirements="ENC-001 ENC-005",
        areas="enc",
    ),
    Mutant(
        id="MU-58o",
        protocol="opcua",
        sentence="Whole numbers of nodes above 2^53 are rounded.",
        bend=_nodes(by_way_of_float),
        items="ENC-005.opcua",
        requirements="ENC-005",
        areas="enc",
    ),
    Mutant(
        id="MU-58q",
        protocol="mqtt",
        sentence="Metrics above 2^53 are rounded.",
        bend=metrics_by_way_of_float,
        items="ENC-005.mqtt",
        requirements="ENC-005",
        areas="enc",
    ),
    Mutant(
        id="MU-123",
        protocol="mqtt",
        sentence="Messages that are no text are lost.",
        bend=binary_is_lost,
        items="ENC-006.mqtt",
        requirements="ENC-006",
        areas="enc",
    ),
    Mutant(
        id="MU-123o",
        protocol="opcua",
        sentence="Characters beyond ASCII become question marks.",
        bend=ascii_texts,
        items="ENC-006.opcua",
        requirements="ENC-006",
        areas="enc",
    ),
    Mutant(
        id="MU-123m",
        protocol="modbus",
        sentence="Texts of the identification are read as Latin-1.",
        bend=latin_identification,
        items="ENC-006.modbus",
        requirements="ENC-006",
        areas="enc",
    ),
    Mutant(
        id="MU-124e",
        protocol="modbus",
        sentence="started_at is the local time with a Z behind it.",
        bend=local_time,
        items="ENC-001.modbus ENC-003.modbus ENC-004.modbus ENC-005.modbus ENC-006.modbus ENC-007.modbus",
        requirements="ENC-007",
        areas="enc",
    ),
    Mutant(
        id="MU-124o",
        protocol="opcua",
        sentence="Timestamps are the local time with a Z behind them.",
        bend=local_timestamps,
        items="ENC-007.opcua",
        requirements="ENC-007",
        areas="enc",
    ),
)
