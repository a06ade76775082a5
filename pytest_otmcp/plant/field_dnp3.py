"""A real DNP3 outstation at ``tcp://host[:port][/OUTSTATION[/MASTER]]``, and the second client that reads it, written on the kit's own codec.

The outstation has the link address OUTSTATION, by default 10; the second client has the one of the master that it answers, by default 1.
Up to 16 analog and 16 binary inputs from the first ones on are read.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext
from typing import Any
from urllib.parse import urlsplit

from ..protocols.dnp3.entries import GROUPS
from ..protocols.dnp3.external import EXTERNAL
from ..protocols.dnp3.field import KINDS
from ..protocols.dnp3.field import points as named
from ..protocols.field import Consent
from ..wire.dnp3.application import READ, RESPONSE, response_fields
from ..wire.dnp3.link import UNCONFIRMED_USER_DATA, LinkFrame, Reassembly, link_length, segments
from ..wire.dnp3.objects import START_STOP8, START_STOP16
from ..wire.framing import MalformedError
from .endpoint import Endpoint
from .field_device import FieldDevice, ReadingClient, UnreachableError, connected
from .tap.stream import StreamTap

__all__ = ["Dnp3Client", "Dnp3FieldDevice"]

_RANGES = ((0, 15), (0, 3), (1, 16), (1, 4))
_FAR = (65535, 9999)
"""Indexes that most outstations do not have."""
_DEFAULT, _FLOAT = 0, 5
"""Variations: what the outstation tells by itself, and analog inputs as numbers of 32 bits with a fraction."""
_ONLINE = 1
"""All flags of a point that the outstation vouches for."""
_NOT_THERE = 0x0600
"""Internal indications for unknown objects and for indexes that are not there (clause 4.5)."""
_PATIENCE_S = 10.0

Answer = Mapping[str, Any]
Read = Callable[[str, int, int, int], Awaitable[Answer]]


class Dnp3FieldDevice(FieldDevice):
    """A real DNP3 outstation."""

    def __init__(self, url: str, consent: Consent | None = None) -> None:
        parts = urlsplit(url)
        host, port = parts.hostname or "127.0.0.1", parts.port or EXTERNAL.default_port
        client = Dnp3Client(host, port, *map(int, parts.path.split("/")[1:]))
        super().__init__("dnp3", url, Endpoint(name="dnp3", kind="tcp", host=host, port=port), client, consent)
        assert isinstance(self.tap, StreamTap), "an outstation is reached by TCP"
        client.turn = self.tap.aside


class Dnp3Client(ReadingClient):
    """The second client, see :class:`~pytest_otmcp.plant.field_device.SecondClient`.

    Attributes:
        turn: makes an outstation that takes one connection at a time free for a look.
    """

    name = "the kit's own DNP3 client"
    elsewhere = "/10/1, outstation and master"
    taken = "DNP3 outstations"

    def __init__(self, host: str, port: int, outstation: int = 10, master: int = 1) -> None:
        self._address = (host, port)
        self._outstation = outstation
        self._master = master
        self._sequence = 0
        self._ranges: dict[str, tuple[int, int]] = {}
        self._points: list[str] = []
        self.turn: Callable[[], AbstractAsyncContextManager[None]] = nullcontext

    async def identity(self) -> str | None:
        """Return None: few outstations say what they are."""
        return None

    async def survey(self) -> Mapping[str, object]:
        """Find points that are told alike as whole numbers and with a fraction, and an index that is not there."""
        beyond: dict[str, object] = {}
        async with self._connection() as read:
            for kind in KINDS.values():
                for place in _RANGES:
                    found = self._vouched(kind, await read(kind, _DEFAULT, *place))
                    if kind == "analog_input" and (exact := self._vouched(kind, await read(kind, _FLOAT, *place))):
                        found = {name: value for name, value in found.items() if exact.get(name) == value}
                    if found:
                        self._ranges[kind] = place
                        self._points += found
                        break
                else:
                    continue
                for index in _FAR:
                    if (await read(kind, _DEFAULT, index, index))["iin"] & _NOT_THERE:
                        beyond[kind] = (self._outstation, index)
                        break
        return beyond

    async def read(self) -> dict[str, object]:
        """Read the points that the survey has found."""
        found: dict[str, object] = {}
        async with self._connection() as read:
            for kind, place in self._ranges.items():
                found |= self._vouched(kind, await read(kind, _DEFAULT, *place))
        if lost := [name for name in self._points if name not in found]:
            raise UnreachableError(f"it does not vouch for {lost[0]} any more")
        return {name: found[name] for name in self._points}

    def _vouched(self, kind: str, answer: Answer) -> Mapping[str, object]:
        """Return the points of an answer that are numbers or truth values and on line."""
        told = [point for one in answer["objects"] if one["group"] == GROUPS[kind] for point in one.get("points", ())]
        good = [one for one in told if one.get("flags", _ONLINE) == _ONLINE and isinstance(one["value"], int | float)]
        return named(self._outstation, kind, {one["index"]: one["value"] for one in good})

    @asynccontextmanager
    async def _connection(self) -> AsyncIterator[Read]:
        async with self.turn(), connected(self._address, link_length, "DNP3", alone=True) as exchange:

            async def read(kind: str, variation: int, start: int, stop: int) -> Answer:
                size, qualifier = (1, START_STOP8) if stop <= 0xFF else (2, START_STOP16)
                objects = bytes([GROUPS[kind], variation, qualifier])
                objects += start.to_bytes(size, "little") + stop.to_bytes(size, "little")
                async with asyncio.timeout(_PATIENCE_S):
                    return await self._asked(exchange, objects)

            # An outstation may take a request with the number of the last one, another client's, for its repetition, and answer as before.
            await read("analog_input", _DEFAULT, 0, 0)
            yield read

    async def _asked(self, exchange: Callable[[bytes], Awaitable[bytes]], objects: bytes) -> Answer:
        self._sequence = (self._sequence + 1) % 16
        (segment,) = segments(bytes([0xC0 | self._sequence, READ]) + objects, self._sequence)
        frame = LinkFrame(
            function=UNCONFIRMED_USER_DATA,
            primary=True,
            from_master=True,
            destination=self._outstation,
            source=self._master,
            data=segment,
        ).encoded()
        parts = Reassembly()
        while True:
            try:
                link = LinkFrame.parse(await exchange(frame))
                # What comes next is waited for.
                frame = b""
                if not link.data or (link.source, link.destination) != (self._outstation, self._master):
                    continue
                answer = None if (fragment := parts.take(link.data)) is None else response_fields(fragment)
            except MalformedError as error:
                raise UnreachableError(f"it does not answer as DNP3 has it: {error}") from None
            if answer and (answer["function"], answer["sequence"]) == (RESPONSE, self._sequence):
                return answer
