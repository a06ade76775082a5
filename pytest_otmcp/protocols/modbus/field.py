"""What the kit may do at a real Modbus device, unit 1."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ...core.finding import Finding
from ...wire.modbus import HEADER, WRITE_COIL, WRITE_COILS, WRITE_REGISTER, WRITE_REGISTERS, mbap_length, request_fields
from ..exercise import Asked
from ..field import Field
from ..journal import Entries, Image
from . import oracle
from .entries import points

__all__ = ["FIELD", "TABLES"]

TABLES: Mapping[str, tuple[str, int]] = {
    "holding_registers": ("read_holding", 3),
    "input_registers": ("read_input", 4),
    "coils": ("read_coils", 1),
    "discrete_inputs": ("read_discrete_inputs", 2),
}
"""Tables with the operation and the function that read them; registers first, which tell more than bits."""

_READ_LENGTHS = {1: 5, 2: 5, 3: 5, 4: 5, 7: 1, 11: 1, 12: 1, 17: 1, 24: 3, 43: 4}
"""Functions that read, to the length of their request (V1.1b3, section 6). Function 8 has sub-functions that restart communication, 22
and 23 write, and what no table lists may do anything."""
_DEVICE_IDENTIFICATION = 14
_SINGLE, _BLOCK, _APART = 5, {WRITE_COILS: 1, WRITE_REGISTERS: 16}, 3


def _pdu(frame: bytes) -> bytes:
    """Return the PDU of a frame that is whole and nothing more; else nothing."""
    return frame[7:] if mbap_length(frame) == len(frame) >= 8 else b""


def _harmless(frame: bytes) -> bool:
    pdu = _pdu(frame)
    if not pdu or _READ_LENGTHS.get(pdu[0]) != len(pdu):
        return False
    return pdu[0] != 43 or pdu[1] == _DEVICE_IDENTIFICATION


def _written(frame: bytes) -> Mapping[str, object] | None:
    pdu = _pdu(frame)
    if not pdu or pdu[0] not in (WRITE_COIL, WRITE_REGISTER, *_BLOCK):
        return None
    asked, unit = request_fields(pdu), HEADER.unpack_from(frame)[3]
    bits = _BLOCK.get(pdu[0])
    if bits is None:
        is_whole = len(pdu) == _SINGLE and (pdu[0] == WRITE_REGISTER or pdu[3:] in (b"\xff\0", b"\0\0"))
    else:
        size = (asked.get("quantity", 0) * bits + 7) // 8
        # A device may go by the quantity or by the number of bytes: they must say the same.
        is_whole = size > 0 and len(pdu) == 6 + size and pdu[5] == size
    if not is_whole:
        return None
    table = "coils" if pdu[0] in (WRITE_COIL, WRITE_COILS) else "holding_registers"
    return points(table, asked["address"], asked["values"], unit=unit)


def _cells(image: Image, table: str) -> dict[int, Any]:
    """Return the cells of a table that an image has, in the order of their addresses."""
    begin = f"1/{table}/"
    found = {int(name.removeprefix(begin)): value for name, value in image["points"].items() if name.startswith(begin)}
    return dict(sorted(found.items()))


def _reads(image: Image, claims: Callable[[str], bool]) -> list[Asked]:
    singles, blocks = [], []
    for table, (operation, _) in TABLES.items():
        if not claims(operation):
            continue
        cells = _cells(image, table)
        first_with = {value: address for address, value in reversed(cells.items())}
        chosen = sorted(first_with.values())[:_APART]
        singles += [_read(operation, table, address, [cells[address]]) for address in chosen]
        if chosen:
            blocks.append(_read(operation, table, chosen[0], list(_run(cells, chosen[0]))))
    return [*singles, *blocks]


def _run(cells: Mapping[int, Any], first: int) -> Iterator[Any]:
    """Yield the values of up to four cells that follow one another."""
    for address in range(first, first + 4):
        if address not in cells:
            return
        yield cells[address]


def _read(operation: str, table: str, address: int, values: list[Any]) -> Asked:
    return Asked(
        operation=operation,
        inputs={"address": address, "count": len(values)},
        outputs={"values": values},
        points=points(table, address, values),
    )


def _beyond(image: Image, claims: Callable[[str], bool]) -> Asked | None:
    refused: Mapping[str, int] = image["beyond"]
    table = next((name for name in refused if claims(TABLES[name][0])), None)
    if table is None:
        return None
    return Asked(operation=TABLES[table][0], inputs={"address": refused[table], "count": 1})


def _write(point: str, value: object) -> Asked | None:
    _, table, address = point.split("/")
    operation = {"holding_registers": "write_holding", "coils": "write_coil"}.get(table)
    if operation is None or not isinstance(value, int) or not 0 <= value <= 0xFFFF:
        return None
    told = bool(value) if table == "coils" else value
    return Asked(
        operation=operation,
        inputs={"address": int(address), "value": told},
        outputs={"value": told},
        points={point: told},
    )


def _where(asked: Asked) -> tuple[str, int]:
    """Return table and first address of what a call is about."""
    _, table, address = next(iter(asked.points)).split("/")
    return table, int(address)


def _was_read(entries: Entries, asked: Asked) -> list[Finding]:
    table, address = _where(asked)
    return oracle.read_from_device(entries, function=TABLES[table][1], address=address, count=len(asked.points))


def _was_written(entries: Entries, asked: Asked) -> list[Finding]:
    table, address = _where(asked)
    return oracle.exactly_one_write(entries, table, address=address, values=list(asked.points.values()))


FIELD = Field(
    harmless=_harmless,
    written=_written,
    reads=_reads,
    beyond=_beyond,
    write=_write,
    was_read=_was_read,
    was_written=_was_written,
    sent=oracle.values_sent,
)
