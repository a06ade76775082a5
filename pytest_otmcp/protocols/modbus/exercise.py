"""What checks for every protocol do on Modbus: holding registers of unit 1."""

from __future__ import annotations

import base64
import random
from collections.abc import Mapping
from functools import partial
from typing import Any

from ...core.strict_json import same_json
from ..exercise import Asked, Clamped, DeviceText, Exercise, Limited, Poke, every_change
from ..journal import JournalEntry
from .entries import as_modbus, points
from .tags import TAGS

__all__ = ["EXERCISE"]

_READ, _WRITTEN = 20, 1
"""Registers that the tasks of the benchmark use as well, so that adapters with a list of their registers know them."""


def _read(rng: random.Random) -> Asked:
    value = rng.randrange(0x10000)
    poke = {"unit": 1, "table": "holding_registers", "address": _READ, "values": [value]}
    return Asked(
        operation="read_holding",
        inputs={"address": _READ, "count": 1},
        outputs={"values": [value]},
        pokes=(poke,),
    )


def _write(rng: random.Random) -> Asked:
    value = rng.randrange(2, 0x10000)
    return Asked(
        operation="write_holding",
        inputs={"address": _WRITTEN, "value": value},
        outputs={"value": value},
        points={f"1/holding_registers/{_WRITTEN}": value},
    )


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    word = rng.randrange(0x100, 0x10000)
    words = [rng.randrange(1, 0x10000) for _ in range(3)]
    bits = [True, *(bool(rng.getrandbits(1)) for _ in range(8)), True]
    old, and_mask, or_mask = (rng.randrange(0x10000) for _ in range(3))
    raw = rng.randrange(1, 0x8000)
    scaled = TAGS["otmcp_scaled"]
    coils, registers = "coils", "holding_registers"
    masked = (old & and_mask) | (or_mask & ~and_mask & 0xFFFF)
    return (
        _write_of("write_holding", registers, 1, [word], value=word),
        _write_of("write_registers", registers, 10, words, values=words),
        _write_of("write_coil", coils, 4, [True], value=True),
        _write_of("write_coils", coils, 20, bits, values=bits),
        _write_of("mask_write", registers, 30, [masked], before=[old], and_mask=and_mask, or_mask=or_mask),
        Asked(
            operation="write_tag",
            inputs={"name": "otmcp_scaled", "value": raw / 10},
            pokes=({"unit": 1, "table": registers, "address": scaled.address, "values": [0]},),
            points=points(registers, scaled.address, [raw]),
        ),
    )


def _write_of(
    operation: str, table: str, address: int, after: list[Any], before: list[Any] | None = None, **inputs: Any
) -> Asked:
    held = before or [False if isinstance(value, bool) else 0 for value in after]
    return Asked(
        operation=operation,
        inputs={"address": address, **inputs},
        pokes=({"unit": 1, "table": table, "address": address, "values": held},),
        points=points(table, address, after),
    )


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # Registers 10 to 19 are what a list can allow.
    def words(count: int) -> list[int]:
        return [rng.randrange(1, 0x10000) for _ in range(count)]

    registers, coils = "holding_registers", "coils"
    shifted = TAGS["otmcp_shifted"].address
    single = (
        _write_of("write_holding", registers, at, [word], value=word) for at in (10, 19, 9, 20) for word in words(1)
    )
    blocks = (
        _write_of("write_registers", registers, at, values, values=values)
        for at, values in ((12, words(3)), (9, words(2)), (19, words(2)), (8, words(14)))
    )
    (word,) = words(1)
    return (
        *single,
        *blocks,
        _write_of("write_coil", coils, 12, [True], value=True),
        _write_of("write_coils", coils, 12, [True, True], values=[True, True]),
        _write_of("mask_write", registers, 20, [0xFFFF], and_mask=0, or_mask=0xFFFF),
        Asked(
            operation="write_tag",
            inputs={"name": "otmcp_shifted", "value": 10.0},
            points=points(registers, shifted, [100]),
        ),
        Asked(
            operation="write_holding",
            inputs={"address": 12, "value": word, "unit": 2},
            points=points(registers, 12, [word], unit=2),
        ),
    )


def _word(address: int, value: float) -> Asked:
    return Asked(
        operation="write_holding",
        inputs={"address": address, "value": value},
        points=points("holding_registers", address, [value]),
    )


def _block(address: int, value: float) -> Asked:
    return Asked(
        operation="write_registers",
        inputs={"address": address, "values": [value]},
        points=points("holding_registers", address, [value]),
    )


def _scaled(value: float) -> Asked:
    return Asked(
        operation="write_tag",
        inputs={"name": "otmcp_scaled", "value": value / 10},
        points=points("holding_registers", TAGS["otmcp_scaled"].address, [value]),
    )


def _identification(text: str) -> Asked:
    # Object 0 is the vendor's name.
    content = base64.b64encode(text.encode()).decode()
    return Asked(operation="read_device_information", inputs={}, pokes=({"unit": 1, "identification": {"0": content}},))


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    return (DeviceText(place="an object of the identification", ask=_identification, longest=200),)


def _clamped(rng: random.Random) -> Clamped:
    highest = rng.randrange(0x100, 0x4000)
    asked = Asked(operation="write_holding", inputs={"address": _WRITTEN, "value": rng.randrange(0x8000, 0x10000)})
    return Clamped(write=asked, output="value", held=highest, action={"clamp": [0, highest]})


def _held_otherwise(point: str, value: object) -> Poke:
    unit, table, address = point.split("/")
    other = not value if isinstance(value, bool) else int(str(value)) ^ 1
    return {"unit": int(unit), "table": table, "address": int(address), "values": [other]}


def _points_of(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    table = {"holding": "holding_registers", "registers": "holding_registers", "coil": "coils", "coils": "coils"}.get(
        operation.removeprefix("write_")
    )
    if table is None:
        return {}
    values = inputs["values"] if "values" in inputs else [inputs["value"]]
    return points(table, inputs["address"], values, unit=inputs.get("unit", 1))


def _is_asked_for(entry: JournalEntry, asked: Asked) -> bool:
    request = as_modbus(entry)
    table = {5: "coils", 15: "coils", 6: "holding_registers", 16: "holding_registers"}.get(request.get("function", 0))
    if table is None:
        return False
    written = points(table, request["address"], [*request.get("values", [])], unit=request["unit"])
    return same_json(written, dict(_points_of(asked.operation, asked.inputs)))


def _refusals(entry: JournalEntry) -> list[str]:
    return [str(as_modbus(entry).get("exception"))] if entry["kind"] == "response" else []


EXERCISE = Exercise(
    reading="read_holding",
    read=_read,
    writing="write_holding",
    write=_write,
    number="value",
    bounded=("address", "count", "value"),
    done=every_change,
    reads=({"function": 3},),
    writes=({"function": 6}, {"function": 16}),
    every_writing=tuple({"function": function} for function in (5, 6, 15, 16, 22)),
    refusals=_refusals,
    silent=({"action": {"drop": True}},),
    reset=({"action": {"reset": True}},),
    refused=({"action": {"exception": 4}},),
    every_write=_every_write,
    fenced=_fenced,
    limited={
        "1/holding_registers/80": Limited(ways=(partial(_word, 80), partial(_block, 80), _scaled), unit=1),
        "1/holding_registers/40": Limited(ways=(partial(_word, 40), partial(_block, 40)), unit=1),
    },
    device_texts=_device_texts,
    clamped=_clamped,
    points_of=_points_of,
    held=_held_otherwise,
    recognised=dict.fromkeys(("write_holding", "write_registers", "write_coil", "write_coils"), _is_asked_for),
    changing=tuple({"function": function} for function in (5, 6, 15, 16, 22)),
)
