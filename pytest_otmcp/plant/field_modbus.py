"""A real Modbus device at ``tcp://host[:port][/FIRST]``, and the second client that reads it, written on the kit's own codec.

From the address FIRST on, by default 0, up to 16 cells of each table of unit 1 are read.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any
from urllib.parse import urlsplit

from ..protocols.field import Consent
from ..protocols.modbus.entries import points as named
from ..protocols.modbus.external import EXTERNAL
from ..protocols.modbus.field import TABLES
from ..wire.modbus import WRITE_COIL, WRITE_REGISTER, frame, mbap_length, response_fields
from .endpoint import Endpoint
from .field_device import FieldDevice, UnreachableError, connected
from .mirror import OwnConnections

__all__ = ["ModbusClient", "ModbusFieldDevice"]

_UNIT = 1
_BLOCKS = (16, 4, 1)
_FAR = (65535, 9999)
"""Addresses that most devices do not have."""
_ILLEGAL_ADDRESS = 2
"""The exception for an address that is not there (V1.1b3, section 7); by any other one a device says something else."""
_IDENTIFY = bytes([0x2B, 0x0E, 1, 0])
"""Read the basic identification (V1.1b3, section 6.21)."""

Ask = Callable[[bytes], Awaitable[bytes]]


class ModbusFieldDevice(FieldDevice):
    """A real Modbus device."""

    def __init__(self, url: str, consent: Consent | None = None) -> None:
        parts = urlsplit(url)
        host, port = parts.hostname or "127.0.0.1", parts.port or EXTERNAL.default_port
        client = ModbusClient(host, port, int(parts.path.strip("/") or 0))
        super().__init__("modbus", url, Endpoint(name="modbus", kind="tcp", host=host, port=port), client, consent)


class ModbusClient:
    """The second client, see :class:`~pytest_otmcp.plant.field_device.SecondClient`."""

    name = "the kit's own Modbus client"
    elsewhere = "/100"
    library: str | None = None

    def __init__(self, host: str, port: int, first: int) -> None:
        self.own: OwnConnections | None = OwnConnections()
        self._address = (host, port)
        self._first = first
        self._blocks: dict[str, int] = {}

    async def identity(self) -> str | None:
        """Return vendor, product and revision."""
        async with self._connection() as ask:
            answer = await ask(_IDENTIFY)
        if answer[0] != _IDENTIFY[0] or len(answer) < 7:
            return None
        rest, texts = answer[7:], []
        while len(rest) >= 2:
            texts.append(rest[2 : 2 + rest[1]].decode("latin-1"))
            rest = rest[2 + rest[1] :]
        return " ".join(texts).strip() or None

    async def survey(self) -> Mapping[str, object]:
        """Find the longest block of each table that can be read, and an address that cannot."""
        beyond: dict[str, object] = {}
        async with self._connection() as ask:
            for table in TABLES:
                sizes = (size for size in _BLOCKS if self._first + size <= 0x10000)
                for size in sizes:
                    if await _read(ask, table, self._first, size) is not None:
                        self._blocks[table] = size
                        break
                else:
                    continue
                for address in _FAR:
                    if (await _answer(ask, table, address, 1)).get("exception") == _ILLEGAL_ADDRESS:
                        beyond[table] = address
                        break
        return beyond

    async def values(self, points: tuple[str, ...] = ()) -> dict[str, object]:
        """Read the blocks, and these points one by one."""
        found: dict[str, object] = {}
        async with self._connection() as ask:
            for table, size in self._blocks.items():
                found |= named(table, self._first, await _must_read(ask, table, self._first, size))
            for point in points:
                if point not in found:
                    found |= await _held(ask, point)
        return found

    async def held(self, points: tuple[str, ...]) -> dict[str, object]:
        """Read these points one by one."""
        async with self._connection() as ask:
            return {name: value for point in points for name, value in (await _held(ask, point)).items()}

    def bounds(self, point: str) -> tuple[float, float]:
        """Return those of a bit or a register."""
        return (0, 1) if _place(point)[0] in ("coils", "discrete_inputs") else (0, 0xFFFF)

    async def write(self, point: str, value: Any) -> None:
        """Write a register or a coil by the function for one."""
        table, address = _place(point)
        function, word = (WRITE_COIL, 0xFF00 if value else 0) if table == "coils" else (WRITE_REGISTER, value)
        async with self._connection() as ask:
            pdu = bytes([function]) + address.to_bytes(2) + word.to_bytes(2)
            if await ask(pdu) != pdu:
                raise UnreachableError(f"it does not confirm the write of {point}")

    @asynccontextmanager
    async def _connection(self) -> AsyncIterator[Ask]:
        async with connected(self._address, mbap_length, "Modbus TCP", own=self.own) as exchange:
            number = 0

            async def ask(pdu: bytes) -> bytes:
                nonlocal number
                number += 1
                answer = await exchange(frame(number, _UNIT, pdu))
                if answer[:2] != number.to_bytes(2) or len(answer) < 9:
                    raise UnreachableError("it answers another request than the one that it was asked")
                return answer[7:]

            yield ask


def _place(point: str) -> tuple[str, int]:
    unit, _, rest = point.partition("/")
    table, _, address = rest.partition("/")
    if unit != str(_UNIT) or table not in TABLES or not address.isdecimal() or int(address) > 0xFFFF:
        raise UnreachableError(f"it has no {point}: expected {_UNIT}/TABLE/ADDRESS, tables are {', '.join(TABLES)}")
    return table, int(address)


async def _answer(ask: Ask, table: str, address: int, count: int) -> dict[str, Any]:
    pdu = bytes([TABLES[table][1]]) + address.to_bytes(2) + count.to_bytes(2)
    return response_fields(await ask(pdu), {"quantity": count})


async def _read(ask: Ask, table: str, address: int, count: int) -> list[Any] | None:
    """Return cells of a table; None where the device refuses."""
    answer = await _answer(ask, table, address, count)
    values: list[Any] = answer.get("values", [])
    return values if answer["function"] == TABLES[table][1] and len(values) == count else None


async def _held(ask: Ask, point: str) -> Mapping[str, object]:
    table, address = _place(point)
    return named(table, address, await _must_read(ask, table, address, 1))


async def _must_read(ask: Ask, table: str, address: int, count: int) -> list[Any]:
    values = await _read(ask, table, address, count)
    if values is None:
        raise UnreachableError(f"it refuses to read {count} of its {table} from {address}")
    return values
