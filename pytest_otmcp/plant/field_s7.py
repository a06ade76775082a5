"""A real S7 controller at ``tcp://host[:port][/DB]``, rack 0, slot 1, and the second client that reads it, written on the kit's own codec.

Of the data block DB, by default 1, up to 16 bytes from the first one on are read.
"""

from __future__ import annotations

import struct
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any
from urllib.parse import urlsplit

from ..protocols.field import Consent
from ..protocols.s7.entries import points as named
from ..protocols.s7.external import EXTERNAL
from ..wire.framing import MalformedError
from ..wire.s7 import JOB, SUCCESS, USER_DATA, Pdu, answer_fields, data_frame, tpkt_length
from .endpoint import Endpoint
from .field_device import FieldDevice, ReadingClient, UnreachableError, connected
from .mirror import OwnConnections

__all__ = ["S7Client", "S7FieldDevice"]

_SIZES = (16, 4, 3)
_FAR = (65535, 9999)
"""Data blocks that most controllers do not have."""
_CONNECT = bytes.fromhex("03000016 11e00000000100 c0010a c1020100 c2020101")
"""COTP connection request to rack 0, slot 1 (X.224, 13.3)."""
_CONFIRMED = 0xD0
_SETUP = bytes.fromhex("f000 0001 0001 01e0")
_ORDER_NUMBER = 0x0011
_NOT_THERE = {0x05, 0x0A}
"""Return codes for an address that is out of range and for an object that does not exist; by any other one a controller says something else."""

Ask = Callable[[int, bytes, bytes], Awaitable[Pdu]]


class S7FieldDevice(FieldDevice):
    """A real S7 controller."""

    def __init__(self, url: str, consent: Consent | None = None) -> None:
        parts = urlsplit(url)
        host, port = parts.hostname or "127.0.0.1", parts.port or EXTERNAL.default_port
        client = S7Client(host, port, int(parts.path.strip("/") or 1))
        super().__init__("s7", url, Endpoint(name="s7", kind="tcp", host=host, port=port), client, consent)


class S7Client(ReadingClient):
    """The second client, see :class:`~pytest_otmcp.plant.field_device.SecondClient`."""

    name = "the kit's own S7 client"
    elsewhere = "/2"
    taken = "S7 controllers"

    def __init__(self, host: str, port: int, db: int) -> None:
        self.own: OwnConnections | None = OwnConnections()
        self._address = (host, port)
        self._db = db
        self._size = 0

    async def identity(self) -> str | None:
        """Return the order number of the module (system status list 11 hex)."""
        async with self._connection() as ask:
            list_of = struct.pack(">BBHHH", SUCCESS, 9, 4, _ORDER_NUMBER, 1)
            answer = await ask(USER_DATA, bytes.fromhex("000112 04 11 44 01 00"), list_of)
        # Return code, transport size, length; list, index, length and number of records; then index and number of the first.
        told = answer.data[14:34].decode("latin-1").strip(" \0") if answer.data[:1] == bytes([SUCCESS]) else ""
        return told or None

    async def survey(self) -> Mapping[str, object]:
        """Find how many bytes of the data block can be read, and a block that cannot."""
        async with self._connection() as ask:
            for size in _SIZES:
                if await _read(ask, self._db, size) is not None:
                    self._size = size
                    break
            missing = [db for db in _FAR if (await _item(ask, db, 1)).get("code") in _NOT_THERE]
        return {"db": missing[0]} if missing else {}

    async def read(self) -> dict[str, object]:
        """Read the bytes that the survey has found."""
        if not self._size:
            raise UnreachableError(f"it refuses to read its data block {self._db}")
        async with self._connection() as ask:
            content = await _read(ask, self._db, self._size)
        if content is None:
            raise UnreachableError(f"it refuses to read its data block {self._db}")
        return dict(named(f"DB{self._db}", 0, content))

    @asynccontextmanager
    async def _connection(self) -> AsyncIterator[Ask]:
        async with connected(self._address, tpkt_length, "S7", own=self.own) as exchange:
            if (await exchange(_CONNECT))[5] != _CONFIRMED:
                raise UnreachableError("it refuses a connection to rack 0, slot 1")
            number = 0

            async def ask(kind: int, parameters: bytes, data: bytes = b"") -> Pdu:
                nonlocal number
                number += 1
                asked = Pdu(rosctr=kind, reference=number, parameters=parameters, data=data)
                answer = await exchange(data_frame(asked.encoded()))
                try:
                    return Pdu.parse(answer[7:])
                except MalformedError as error:
                    raise UnreachableError(f"it does not speak S7: {error}") from None

            await ask(JOB, _SETUP)
            yield ask


async def _item(ask: Ask, db: int, size: int) -> Mapping[str, Any]:
    """Return what a controller says of the first bytes of a data block."""
    pointer = bytes.fromhex("04 01 12 0a 10 02") + struct.pack(">HHB", size, db, 0x84) + bytes(3)
    items: list[Mapping[str, Any]] = answer_fields(await ask(JOB, pointer, b""))["items"]
    return items[0] if items else {}


async def _read(ask: Ask, db: int, size: int) -> bytes | None:
    """Return the first bytes of a data block; None where the controller refuses."""
    content = bytes.fromhex((await _item(ask, db, size)).get("data", ""))
    return content if len(content) == size else None
