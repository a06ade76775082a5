"""What checks for every protocol do on EtherCAT: objects of the drive that are read and written, and the outputs of both slaves."""

from __future__ import annotations

import random
import struct
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ..exercise import Asked, Contended, DeviceText, Exercise, Limited, Texts
from ..journal import Entries, JournalEntry
from ..point import FLOAT32, INT16, different_bytes, half, large
from .entries import as_ethercat, points
from .points import (
    ACCELERATION,
    DRIVE,
    KINDS,
    LONGEST,
    TERMINAL,
    TEXTS,
    TYPED,
    bytes_of,
    inputs_of,
    object_at,
    output_named,
    outputs_of,
)

__all__ = ["EXERCISE"]

_READ, _WRITTEN, _TARGET = TYPED["INT16"], TYPED["UINT16"], TYPED["INT32"]
_SETPOINT, _LIMIT = output_named("otmcp_setpoint", INT16, 0), output_named("otmcp_limit", FLOAT32, 4)
_WHOLE = ("INT8", "UINT8", "INT16", "UINT16", "INT32", "UINT32")


def _write(rng: random.Random) -> Asked:
    return _WRITTEN.write(rng.randrange(2, 0x8000), before=0)


def _done(entries: Entries, asked: Asked) -> list[JournalEntry]:
    service = "sdo_download" if asked.operation == "write_sdo" else None
    return [one for one in entries if one["state_changing"] and service in (None, as_ethercat(one).get("service"))]


def _distinct(rng: random.Random, count: int) -> tuple[Asked, ...]:
    # A condition of a fault plan is about a slave: one that delays the answers of the drive must not be met by the terminal.
    inputs = inputs_of(TERMINAL).read(bytes_of(rng, TERMINAL))
    inputs = replace(inputs, condition={"service": "inputs", "slave": TERMINAL})
    known = [_READ.any(rng), inputs, TYPED["UINT32"].any(rng), TYPED["INT32"].any(rng)]
    return tuple(known[index % len(known)] for index in range(count))


def _every_read(rng: random.Random) -> tuple[Asked, ...]:
    return (
        # Twice each: inputs of an earlier exchange are another value.
        *(inputs_of(slave).read(bytes_of(rng, slave)) for slave in (TERMINAL, DRIVE, TERMINAL, DRIVE)),
        *map(TYPED["BOOL"].read, (True, False)),
        *(TYPED[kind].read(KINDS[kind].telling(rng)) for kind in (*_WHOLE, "FLOAT32", "FLOAT64")),
    )


def _every_write(rng: random.Random) -> tuple[Asked, ...]:
    # No byte is zero, as those of a slave are that is not in OP.
    return (
        _write(rng),
        outputs_of(TERMINAL).write(bytes_of(rng, TERMINAL)),
        outputs_of(DRIVE).write(bytes_of(rng, DRIVE)),
        _SETPOINT.write(rng.randrange(0x101, 0x7F00)),
        _LIMIT.write(rng.randrange(1, 2**20) + 0.5),
    )


def _contended(rng: random.Random) -> Contended:
    return _TARGET.contended(*different_bytes(rng, "<i"))


def _asks_for(entry: JournalEntry) -> object:
    sent = as_ethercat(entry)
    if sent.get("service") != "sdo_download" or len(sent["data"]) != 8:
        return None
    return int.from_bytes(bytes.fromhex(sent["data"]), "little", signed=True)


def _fenced(rng: random.Random) -> tuple[Asked, ...]:
    # The acceleration, and the outputs of the terminal, are what a list can allow.
    return (
        ACCELERATION.write(rng.randrange(1, 99)),
        _WRITTEN.write(rng.randrange(1, 99)),
        object_at(0x2002, 0, "STRING").write("fence"),
        outputs_of(TERMINAL).write(bytes_of(rng, TERMINAL)),
        outputs_of(DRIVE).write(bytes_of(rng, DRIVE)),
        _LIMIT.write(rng.randrange(1, 2**20) + 0.5),
    )


def _bounds() -> tuple[tuple[Asked, object], ...]:
    return (
        *(pair for kind in _WHOLE for pair in TYPED[kind].bounds(before=1)),
        TYPED["FLOAT32"].bounds(before=1.0)[0],
    )


def _misfits() -> tuple[tuple[Asked, tuple[object, ...]], ...]:
    return TYPED["INT16"].misfits(before=1), TYPED["FLOAT32"].misfits(before=1.0)


def _write_text(text: str) -> Asked:
    return TEXTS.write(text, before="")


def _device_texts(name: str) -> tuple[DeviceText, ...]:
    return (DeviceText(place="an object", ask=TEXTS.read, longest=LONGEST, encoding="latin-1"),)


def _points_of(operation: str, inputs: Mapping[str, Any]) -> Mapping[str, object]:
    if operation == "write_outputs":
        return points(inputs["slave"], "output", bytes(inputs["data"]))
    kind = str(inputs.get("type"))
    if operation != "write_sdo" or kind not in KINDS:
        return {}
    try:
        return object_at(inputs["index"], inputs["subindex"], kind, inputs["slave"]).held(inputs["value"])
    except struct.error:
        # The type has no such value.
        return {}


def _refusals(entry: JournalEntry) -> list[str]:
    abort = as_ethercat(entry).get("abort")
    return [] if abort is None else [f"{abort:08X}"]


def _real(value: float) -> Asked:
    return TYPED["FLOAT32"].write(value, before=half(random.Random(1)))


EXERCISE = Exercise(
    points_of=_points_of,
    reading="read_sdo",
    read=_READ.any,
    writing="write_sdo",
    write=_write,
    number="value",
    bounded=("index", "subindex"),
    done=_done,
    reads=({"service": "sdo_upload"},),
    writes=({"service": "sdo_download"},),
    refusals=_refusals,
    silent=({"action": {"drop": True}},),
    # A cable has no connection that could be reset: what comes nearest is that an answer is lost.
    reset=tuple({"service": service, "action": {"drop": True}} for service in ("sdo_download", "sdo_upload")),
    refused=({"service": "sdo_upload", "action": {"abort": 0x06060000}},),
    write_refused=({"abort": 0x06060000}, "device_failure"),
    # An index has 16 bits, a subindex 8.
    outside={
        "index": (-1, 2**16, 2**16 + 0x2001, 2**31, 8193.5),
        "subindex": (-1, 2**8, 2**8 + 3, 2**31, 3.5, "0x3"),
    },
    distinct=_distinct,
    every_read=_every_read,
    every_write=_every_write,
    contended=_contended,
    fenced=_fenced,
    limited={
        "1:2000:1": Limited(ways=(ACCELERATION.write,), unit=1),
        "1.output.0": Limited(ways=(_SETPOINT.write,), unit=1),
    },
    asks_for=_asks_for,
    bounds=_bounds,
    misfits=_misfits,
    large=large(TYPED["INT64"], TYPED["UINT64"]),
    floats={"float32": TYPED["FLOAT32"].read, "float64": TYPED["FLOAT64"].read},
    real=_real,
    # CiA 301: a VISIBLE_STRING has characters from 20h to 7Eh, and zeros.
    texts=Texts(encoding="latin-1", longest=LONGEST, filled_up=True, read=TEXTS.read, write=_write_text),
    device_texts=_device_texts,
    changing=({"changes": True},),
)
