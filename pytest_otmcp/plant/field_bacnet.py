"""A real BACnet/IP device at ``udp://host[:port][/DEVICE[/FIRST]]``, and the second client that reads it, written on the kit's own codec.

DEVICE is the instance of the device, which most tell who asks them by Who-Is. From the element FIRST of its object list on, by default the first one,
up to 16 present values are read, of analog and of multi-state objects: adapters tell the states of binary ones as numbers, as names or as truth values.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Any
from urllib.parse import urlsplit

from ..protocols.bacnet.entries import PRESENT_VALUE, label
from ..protocols.bacnet.external import EXTERNAL
from ..protocols.bacnet.field import UNHEARD
from ..protocols.field import Consent
from ..wire.bacnet.frames import Apdu, LinkMessage, NetworkMessage, PduType, frame_of, head_of, unicast
from ..wire.bacnet.services import Confirmed, Unconfirmed, answer_fields
from ..wire.bacnet.values import Tags, context, value_of
from ..wire.framing import MalformedError
from .endpoint import Endpoint
from .field_device import FieldDevice, ReadingClient, UnreachableError

__all__ = ["BacnetClient", "BacnetFieldDevice"]

_TRANSMISSIONS, _WAIT_S = 3, 2.0
_LISTED, _READ = 128, 16
_NUMBERS, _KINDS = (0, 1, 2, 13, 14, 19), ("real", "unsigned")
"""Types of analog and multi-state inputs, outputs and values, and the datatypes of their present values."""
_ANALOG_INPUT, _DEVICE, _ANY = 0, 8, 4194303
"""Types of objects, and the instance that no device has (clause 20.2.14)."""
_FAR = (4194301, 999983)
"""Instances that most devices do not have."""
_OBJECT_LIST, _IDENTITY = 76, (121, 70, 44)
"""Properties of the device: its objects; the name of the vendor and of the model, revision of the firmware."""
_UNKNOWN_OBJECT = [1, 31]
"""The error for an object that is not there (clause 18); by any other one a device says something else."""
_LARGEST_DATAGRAM = 65_535
_LARGEST_ANSWER = 5
"""1476 bytes, in one segment (clause 20.1.2)."""

Target = tuple[int, int]
"""Type and instance of an object."""
Said = list[dict[str, Any]]
"""Values of a property, each with its type."""


class BacnetFieldDevice(FieldDevice):
    """A real BACnet/IP device."""

    def __init__(self, url: str, consent: Consent | None = None) -> None:
        parts = urlsplit(url)
        host, port = parts.hostname or "127.0.0.1", parts.port or EXTERNAL.default_port
        device, _, first = parts.path.strip("/").partition("/")
        self._reader = BacnetClient(host, port, int(device or _ANY), int(first or 1))
        target = Endpoint(name="bacnet", kind="udp", host=host, port=port)
        super().__init__("bacnet", url, target, self._reader, consent)

    async def check(self) -> None:
        """Find out as well whether adapters can look for the device."""
        await super().check()
        if not self._reader.is_heard:
            self.gate.field = UNHEARD


class BacnetClient(ReadingClient):
    """The second client, see :class:`~pytest_otmcp.plant.field_device.SecondClient`.

    Attributes:
        is_heard: the device answers a Who-Is to who asks it.
    """

    name = "the kit's own BACnet client"
    elsewhere = "/12345/100"
    taken = "BACnet devices"

    def __init__(self, host: str, port: int, device: int, first: int) -> None:
        self._address = (host, port)
        self._own: Target = (_DEVICE, device)
        self._first = first
        self._objects: list[Target] = []
        self.is_heard = False

    async def identity(self) -> str | None:
        """Find out which device this is; return its vendor, its model and its revision."""
        async with self._connection() as device:
            with suppress(UnreachableError):
                self._own = await device.looked_for(self._own[1])
                self.is_heard = True
            if self._own[1] == _ANY:
                raise UnreachableError(
                    "it does not answer a Who-Is; where it broadcasts the answer, name its instance, such as /12345 behind the port"
                )
            texts = [await device.told(self._own, number) for number in _IDENTITY]
        return " ".join(str(text[0]["value"]) for text in texts if text) or None

    async def survey(self) -> Mapping[str, object]:
        """Look through the object list for numbers; find an object that is not there."""
        async with self._connection() as device:
            count = await device.told(self._own, _OBJECT_LIST, 0)
            if not count:
                raise UnreachableError(f"as device {self._own[1]} it does not tell which objects it has")
            for index in range(max(1, self._first), min(count[0]["value"] + 1, self._first + _LISTED)):
                for listed in await device.told(self._own, _OBJECT_LIST, index):
                    target = (listed["value"][0], listed["value"][1])
                    if target[0] in _NUMBERS and await device.number(target) is not None:
                        self._objects.append(target)
                if len(self._objects) == _READ:
                    break
            for instance in _FAR:
                missing = (_ANALOG_INPUT, instance)
                if (await device.answer(missing, PRESENT_VALUE)).get("error") == _UNKNOWN_OBJECT:
                    return {"point": self._point(missing)}
        return {}

    async def read(self) -> dict[str, object]:
        """Read the present values that the survey has found."""
        async with self._connection() as device:
            found = {self._point(target): await device.number(target) for target in self._objects}
        if refused := [point for point, value in found.items() if value is None]:
            raise UnreachableError(f"it tells no number for {refused[0]}")
        return dict(found)

    def _point(self, target: Target) -> str:
        return f"{self._own[1]}/{label(target)}"

    @asynccontextmanager
    async def _connection(self) -> AsyncIterator[_Connection]:
        loop = asyncio.get_running_loop()
        try:
            (family, _, _, _, address), *_ = await loop.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)
            with socket.socket(family, socket.SOCK_DGRAM) as own:
                own.setblocking(False)
                own.connect(address)
                yield _Connection(own)
        except OSError as error:
            raise UnreachableError(str(error)) from None
        except (MalformedError, LookupError, TypeError) as error:
            raise UnreachableError(f"it does not speak BACnet: {error}") from None


class _Connection:
    """A socket to the device. Datagrams get lost: a request is sent again, with the same invoke id (clause 5.4)."""

    def __init__(self, own: socket.socket) -> None:
        self._own = own
        self._number = 0

    async def looked_for(self, device: int) -> Target:
        """Return the device that answers a Who-Is, this one or, where it is not known, any."""

        def is_told(one: Apdu) -> bool:
            is_i_am = one.kind == PduType.UNCONFIRMED_REQUEST and one.service == Unconfirmed.I_AM
            return is_i_am and device in (_ANY, _instance(one))

        asked = bytes([PduType.UNCONFIRMED_REQUEST << 4, Unconfirmed.WHO_IS])
        return _DEVICE, _instance(await self._exchange(unicast(asked), is_told))

    async def answer(self, target: Target, number: int, index: int | None = None) -> dict[str, Any]:
        """Return what the device says when it is asked for a property."""
        self._number = (self._number + 1) & 0xFF
        asked = bytes([0, _LARGEST_ANSWER, self._number, Confirmed.READ_PROPERTY])
        asked += context(0, "object-identifier", target) + context(1, "unsigned", number)
        if index is not None:
            asked += context(2, "unsigned", index)
        return answer_fields(await self._exchange(unicast(asked, expects_reply=True), self._is_answer))

    def _is_answer(self, one: Apdu) -> bool:
        return one.kind > PduType.UNCONFIRMED_REQUEST and one.invoke_id == self._number

    async def told(self, target: Target, number: int, index: int | None = None) -> Said:
        """Return the values of a property; none where the device refuses."""
        results = (await self.answer(target, number, index)).get("results", [])
        values: Said = results[0]["values"] if results else []
        return values

    async def number(self, target: Target) -> int | float | None:
        """Return a present value; None where it is no single number."""
        values = await self.told(target, PRESENT_VALUE)
        value = values[0]["value"] if len(values) == 1 else None
        return value if values and values[0]["type"] in _KINDS and isinstance(value, int | float) else None

    async def _exchange(self, datagram: bytes, answers: Callable[[Apdu], bool]) -> Apdu:
        loop = asyncio.get_running_loop()
        for _ in range(_TRANSMISSIONS):
            await loop.sock_sendall(self._own, datagram)
            with suppress(TimeoutError):
                async with asyncio.timeout(_WAIT_S):
                    while True:
                        received = await loop.sock_recv(self._own, _LARGEST_DATAGRAM)
                        # Whatever else the device sends is for somebody else, or about something else.
                        with suppress(MalformedError, LinkMessage, NetworkMessage):
                            if answers(found := head_of(frame_of(received, answer=True).apdu)):
                                return found
        raise UnreachableError("it does not answer")


def _instance(told: Apdu) -> int:
    """Return the instance of the device that an I-Am is from."""
    _, instance = value_of("object-identifier", Tags(told.data).next().content).value
    return int(instance)
