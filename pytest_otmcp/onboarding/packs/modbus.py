"""Words and experiments for tools that speak Modbus."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence
from typing import Any

from ...protocols.exercise import Asked
from ...protocols.journal import Entries, JournalEntry
from ...protocols.modbus.entries import ModbusEntry, as_modbus
from ...protocols.modbus.registers import ORDERS
from ..evidence import beyond
from ..experimenter import Experimenter
from ..experiments import every_write
from ..guess import Guess
from ..known_causes import KnownCause
from ..pack import Hints, Pack, plain
from ..proposal import Proposal, Shown
from ..status import reach

__all__ = ["PACK"]

_READ_COILS, _READ_DISCRETE_INPUTS = 1, 2
_BITS = 40
_READ_HOLDING, _READ_INPUT, _WRITE_SINGLE, _WRITE_MULTIPLE = 3, 4, 6, 16
_VALUES = range(2000, 0x8000)
"""Values that cannot be mistaken for an address, a count or a default, and that have no sign to be mistaken."""

_TABLE = r"^(kind|table|type|register_type|area|source)$"

Find = Callable[[Entries], ModbusEntry | None]
"""A function that finds the request that a call has to make among the device's journal entries."""


async def _read_input(experimenter: Experimenter, guess: Guess) -> Proposal:
    return await _read(experimenter, guess, "input_registers", _READ_INPUT, (30001, 30000, 1))


async def _read_holding(experimenter: Experimenter, guess: Guess) -> Proposal:
    return await _read(experimenter, guess, "holding_registers", _READ_HOLDING, (40001, 40000, 1))


async def _read(
    experimenter: Experimenter, guess: Guess, table: str, function: int, offsets: tuple[int, ...]
) -> Proposal:
    values = [experimenter.random.choice(_VALUES) for _ in range(3)]
    await experimenter.device.poke(unit=1, table=table, address=10, values=values)
    shown, asked, offset = await _call_at(experimenter, guess, _requests(function), offsets, address=10, count=3)
    proven = asked is not None and asked["address"] == 10 and asked["quantity"] == 3
    seen = _others(shown.entries)
    if asked is not None:
        seen = f"function {function} for address {asked['address']}, quantity {asked['quantity']}"
    proposal = experimenter.propose(guess, shown, proven=proven, seen=seen, offset=offset)
    experimenter.locate(proposal, "values", values)
    if proven:
        experimenter.provoke(proposal, "illegal_address", address=9999, count=1)
    return proposal


def _samples(rng: random.Random) -> tuple[Asked, ...]:
    """Return reads at three addresses of each table: several values, one alone, and the bounds of a register."""
    words, bits = rng.sample(_VALUES, 5), [rng.random() < 0.5 for _ in range(_BITS)]
    bounds: dict[bool, list[Any]] = {True: [0, 0xFFFF, 0x8000, 1], False: [True, False]}
    tables: dict[str, tuple[str, list[Any]]] = {
        "read_input": ("input_registers", words),
        "read_holding": ("holding_registers", words),
        "read_coils": ("coils", bits),
        "read_discrete_inputs": ("discrete_inputs", bits),
    }
    return tuple(
        Asked(
            operation=operation,
            inputs={"address": address, "count": len(values)},
            outputs={"values": values},
            pokes=({"unit": 1, "table": table, "address": address, "values": values},),
        )
        for operation, (table, several) in tables.items()
        for address, values in ((50, several), (77, several[2:3]), (90, bounds[several is words]))
    )


async def _read_coils(experimenter: Experimenter, guess: Guess) -> Proposal:
    return await _read_bits(experimenter, guess, "coils", _READ_COILS)


async def _read_discrete_inputs(experimenter: Experimenter, guess: Guess) -> Proposal:
    return await _read_bits(experimenter, guess, "discrete_inputs", _READ_DISCRETE_INPUTS)


async def _read_bits(experimenter: Experimenter, guess: Guess, table: str, function: int) -> Proposal:
    # As many as no two random rows of bits have in common.
    values = [experimenter.random.random() < 0.5 for _ in range(_BITS)]
    await experimenter.device.poke(unit=1, table=table, address=10, values=values)
    offsets = (10001, 10000, 1)
    shown, asked, offset = await _call_at(
        experimenter, guess, _requests(function), offsets, address=10, count=len(values)
    )
    proven = asked is not None and asked["address"] == 10 and asked["quantity"] == len(values)
    seen = _others(shown.entries)
    if asked is not None:
        seen = f"function {function} for address {asked['address']}, quantity {asked['quantity']}"
    proposal = experimenter.propose(guess, shown, proven=proven, seen=seen, offset=offset)
    experimenter.locate(proposal, "values", values)
    return proposal


async def _write_holding(experimenter: Experimenter, guess: Guess) -> Proposal:
    value = experimenter.random.choice(_VALUES)
    find = _requests(_WRITE_SINGLE, _WRITE_MULTIPLE)
    shown, written, offset = await _call_at(experimenter, guess, find, (40001, 40000, 1), address=12, value=value)
    proven = written is not None and written["address"] == 12 and written["values"] == [value]
    seen = _others(shown.entries)
    if written is not None:
        seen = f"function {written['function']} for address {written['address']}, {written['values']}"
    proposal = experimenter.propose(guess, shown, proven=proven, seen=seen, offset=offset)
    if proven:
        experimenter.locate_echo(proposal, "value", value)
        experimenter.provoke(proposal, "range_overflow", address=12, value=70000)
    return proposal


async def _call_at(
    experimenter: Experimenter, guess: Guess, find: Find, offsets: Sequence[int], **inputs: Any
) -> tuple[Shown, ModbusEntry | None, dict[str, int]]:
    """Call the tool and find out from which number it counts addresses.

    Tools count registers from 0, from 1, or as 40001: the offset is the difference that the first call showed, or one of
    ``offsets``.

    Returns:
        The observations of a call, its request, and the offset that led to the address asked for; those of the first
        call, without an offset, when no offset led there.
    """
    address = inputs["address"]
    shown = await experimenter.call(guess, {}, **inputs)
    request = find(shown.entries)
    if request is not None and request["address"] == address:
        return shown, request, {}
    difference = 0 if request is None else address - request["address"]
    for offset in dict.fromkeys((difference, *offsets)):
        if offset:
            again = await experimenter.call(guess, {"address": offset}, **inputs)
            found = find(again.entries)
            if found is not None and found["address"] == address:
                return again, found, {"address": offset}
    return shown, request, {}


def _others(entries: Entries) -> str:
    """Say which requests came instead of the one that was looked for; nothing when there were none."""
    asked = [as_modbus(entry) for entry in entries if entry["kind"] == "request"]
    functions = dict.fromkeys(request["function"] for request in asked)
    return "" if not functions else f"function {', '.join(map(str, functions))} instead"


def _requests(*functions: int) -> Find:
    def find(entries: Entries) -> ModbusEntry | None:
        asked = (as_modbus(entry) for entry in entries if entry["kind"] == "request")
        return next((request for request in asked if request["function"] in functions), None)

    return find


_COMMANDS = {5: "write_coil", 6: "write_holding", 15: "write_coils", 16: "write_registers"}
"""Functions of writes that a named command may have, to the operation that asks for them."""


def _told(entry: JournalEntry) -> tuple[str, dict[str, object]] | None:
    request = as_modbus(entry)
    operation, values = _COMMANDS.get(request.get("function", 0)), request.get("values")
    if operation is None or not values or request.get("unit") != 1:
        return None
    if len(values) == 1:
        operation = {"write_coils": "write_coil", "write_registers": "write_holding"}.get(operation, operation)
    told: dict[str, object] = {"address": request["address"]}
    return operation, told | ({"values": list(values)} if operation.endswith("s") else {"value": values[0]})


_READS = {1: "read_coils", 2: "read_discrete_inputs", 3: "read_holding", 4: "read_input"}
"""Functions of reads to the operation that asks for them."""
_TYPED = {"read_holding": "read_typed", "read_input": "read_typed_input"}
_TYPES = {1: ("int16",), 2: ("float32", "int32", "uint32"), 4: ("float64", "int64", "uint64")}
"""Registers of a number to its types."""
_LONGEST_BLOCK = 32


def _sources(entry: JournalEntry) -> list[tuple[str, dict[str, object]]]:
    request = as_modbus(entry)
    operation, count = _READS.get(request.get("function", 0)), request.get("quantity") or 0
    if entry["kind"] != "request" or operation is None or request.get("unit") != 1 or count > _LONGEST_BLOCK:
        return []
    cells = range(request["address"], request["address"] + count)
    found: list[tuple[str, dict[str, object]]] = [(operation, {"address": cell, "count": 1}) for cell in cells]
    for length, types in _TYPES.items() if operation in _TYPED else ():
        for address in cells[: len(cells) - length + 1]:
            orders = ORDERS if length > 1 else ORDERS[:1]
            found += [
                (
                    _TYPED[operation],
                    {"address": address, "type": kind} | ({} if order == ORDERS[0] else {"byte_order": order}),
                )
                for kind in types
                for order in orders
            ]
    return found


_ALL_TABLES = r"(read|get)_?registers?"
"""Names of tools that may read all four tables, told apart by numbers such as 40001."""
_UNIT = r"^(unit|unit_id|unitid|slave|slave_id|slaveid)$"

PACK = Pack(
    protocol="modbus",
    operations={
        "ping": Hints(
            likely="ping status health connection probe info",
            unlikely="read write mask scan list job template proxy listener frame log connect disconnect reconnect command",
            needed="ping status health connection probe info check",
            experiment=reach,
        ),
        "read_input": Hints(
            likely="read get input register value",
            unlikely="write set coil coils discrete mask file fifo exception information history holding",
            needed="read get",
            experiment=_read_input,
            choice=re.compile(r"^(?!.*discrete).*input", re.IGNORECASE),
            trials={_TABLE: ("input", "ir", "input_register", "input_registers")},
        ),
        "read_holding": Hints(
            likely="read get holding register value",
            unlikely="write set coil coils discrete mask file fifo exception information history input",
            needed="read get",
            experiment=_read_holding,
            choice=re.compile(r"^(?!.*discrete).*holding", re.IGNORECASE),
            trials={_TABLE: ("holding", "hr", "holding_register", "holding_registers")},
        ),
        "write_holding": Hints(
            likely="write set holding register value",
            unlikely="read coil coils mask file",
            needed="write set",
            experiment=_write_holding,
            choice=re.compile(r"^(?!.*discrete).*holding", re.IGNORECASE),
            trials={_TABLE: ("holding", "hr", "holding_register", "holding_registers")},
        ),
        "read_coils": plain(
            "coil coils bit bits", rf"(?!\w*discrete)(read|get)\w*(coil|bit)s?(_?(status|states?|values?))?|{_ALL_TABLES}", _read_coils
        ),
        "read_discrete_inputs": plain(
            "discrete input inputs",
            rf"(read|get)\w*discrete(_?inputs?)?(_?(status|states?|values?))?|{_ALL_TABLES}",
            _read_discrete_inputs,
        ),
        "read_typed": plain("typed holding", r"(?!\w*input)(read|get)\w*typed\w*"),
        "read_typed_input": plain("typed input", r"(read|get)\w*(input\w*typed|typed\w*input)\w*"),
        "read_device_information": plain(
            "device information identification",
            r"(read|get)_?device_?(information|info|identification|id)|identify(_?device)?",
        ),
        "read_tag": plain("tag", r"(read|get)_?tag(_?value)?"),
        "write_registers": plain("registers", r"(write|set)_?(multiple_?)?(holding_?)?registers(_?bulk)?", every_write("write_registers")),
        "write_coil": plain("coil bit", r"(write|set|force)_?(single_?)?(coil|bit|registers?)", every_write("write_coil")),
        "write_coils": plain("coils bits", r"(write|set|force)_?(multiple_?)?(coil|bit|register)s(_?bulk)?", every_write("write_coils")),
        "mask_write": plain("mask write register", r"mask_?write(_?(holding_?)?register)?", every_write("mask_write")),
        "write_tag": plain("tag", r"(write|set)_?tag(_?value)?"),
    },
    arguments={
        "address": "address addr start start_address starting_address register register_address coil coil_address offset index",
        "values": "values data states",
        "type": "data_type type datatype dtype",
        "name": "tag tag_name name",
        "and_mask": "and_mask",
        "or_mask": "or_mask",
        "count": "count quantity num number length size qty num_registers register_count n how_many",
    },
    lists=frozenset({"values"}),
    # The mock device's unit identifier.
    constants={_UNIT: 1},
    stand_ins={"unit": _UNIT},
    names=("modbus", "modbus-tcp", "modbus_tcp", "tcp"),
    told=_told,
    sources=_sources,
    samples=_samples,
    errors={
        "illegal_address": (
            r"(?i)0x0?2\b|exception[ _]code\W{0,4}2\b|illegal.?data.?address",
        ),
        "range_overflow": (
            beyond("number <= 65535", "less than or equal to 65535", "overflow"),
        ),
    },
    causes=(
        KnownCause(
            group="library",
            pattern=r"unexpected keyword argument '(slave|unit)'",
            cause="It was written for an earlier version of pymodbus, whose argument of that name is gone.",
            remedy="Install it with 'pymodbus<3.10'.",
        ),
    ),
)  # fmt: skip
