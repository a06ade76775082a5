"""A broker of somebody else's as the MQTT device of the bench: the tap in front of it is the witness.

The class offers what :class:`~pytest_otmcp.plant.mock_device.MockDevice` offers. Stopping and starting it takes the tap's port away
and brings it back: the broker itself is nobody's to stop, and adapters cannot tell the difference.
"""

from __future__ import annotations

import asyncio
import base64
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import Any, cast
from urllib.parse import urlsplit

from ..core.errors import KitError
from ..protocols.framing import Framer
from ..protocols.mqtt.decoder import MqttConversation, packet_length
from ..protocols.protocol import Framing
from .mock_device import Entry, Journal
from .tap.journal import TapJournal
from .tap.proxy import Tap

__all__ = ["TappedBroker"]

KIT_CLIENT = "otmcp-kit"
_ANSWER_TIMEOUT_S = 5.0


class TappedBroker:
    """The broker at ``mqtt://host[:port]``, reached through a tap.

    Attributes:
        tap: the tap, for fault rules.
        host, port: where adapters connect: the tap.
        running: the tap accepts connections.
        accepting_ns: monotonic; since when it does.
    """

    name = "mqtt"

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self._url = url
        self._broker = (parts.hostname or "127.0.0.1", parts.port or 1883)
        self.tap = Tap(*self._broker, framing=Framing(frame_length=packet_length, conversation=MqttConversation))
        self.host = self.tap.host
        self.port = 0
        self.running = False
        self.accepting_ns = 0

    # -- life ---------------------------------------------------------------------------------------------

    async def launch(self) -> None:
        """Make sure that the broker is there, and start the tap.

        Raises:
            KitError: nobody answers CONNECT there.
        """
        async with self._connection():
            pass
        await self.tap.start()
        self.port = self.tap.port
        self._accepts()

    def _accepts(self) -> None:
        self.accepting_ns = time.monotonic_ns()
        self.running = True

    async def stop(self) -> None:
        """The endpoint vanishes: its connections are reset, its port refuses."""
        await self.tap.down()
        self.running = False

    async def start(self) -> None:
        """The endpoint is back on the same port, with an empty journal that counts from 0 again."""
        self.tap.medium.journal = TapJournal()
        await self.tap.up()
        self._accepts()

    async def close(self) -> None:
        """End the tap; the broker is left as it is."""
        self.running = False
        await self.tap.aclose()

    # -- witness ------------------------------------------------------------------------------------------

    async def image(self) -> dict[str, Any]:
        """Not to be had.

        Raises:
            KitError: always; only a mock can be asked what it holds.
        """
        raise KitError(f"the broker {self._url} cannot be asked what it holds")

    async def mark(self) -> int:
        """Sequence number that the next journal entry will get."""
        return self.tap.journal.next_seq

    async def journal(self, since: int) -> Journal:
        """The entries from ``since`` on.

        Raises:
            KitError: the oldest of them were released, or have given way to newer ones.
        """
        return Journal(
            entries=cast("list[Entry]", self.tap.journal.entries(since)), next=self.tap.journal.next_seq
        ).whole(since)

    async def forget(self, before: int) -> None:
        """Release the entries before ``before`` for good: they have been read."""
        self.tap.journal.forget(before)

    async def wait(self, since: int, match: Mapping[str, Any], *, timeout_s: float, count: int = 1) -> list[Entry]:
        """The entries from ``since`` on whose fields equal ``match``, as soon as there are ``count`` of them, or
        those there are when the time is over."""
        return cast("list[Entry]", await self.tap.journal.wait(since, match, count, timeout_s))

    async def poke(self, *, publish: Mapping[str, Any]) -> None:
        """Publish a message past the tap: ``topic``, ``payload`` (base64), ``qos`` (0 or 1), ``retain``.

        Returns when the broker has taken it; noted on the journal as connection 0.
        """
        topic, payload = str(publish["topic"]), base64.b64decode(publish["payload"])
        qos, retain = int(publish.get("qos", 0)), bool(publish.get("retain", False))
        text = topic.encode()
        identifier = b"\0\1" if qos else b""
        content = len(text).to_bytes(2) + text + identifier + payload
        fields = {"topic": topic, "payload": publish["payload"], "qos": qos, "retain": retain, "dup": False}
        self.tap.journal.event(0, "in", "PUBLISH", client_id=KIT_CLIENT, **fields)
        async with self._connection() as writer:
            writer.write(_packet(0x30 | qos << 1 | retain, content))

    async def reset(self) -> None:
        """No faults; what the broker retains is left as it is."""
        self.tap.inject()

    async def tick(self, steps: int = 1) -> None:
        """Nothing: there is no simulation behind a broker of somebody else's."""

    @asynccontextmanager
    async def _connection(self) -> AsyncIterator[asyncio.StreamWriter]:
        """A connection of the kit's own; at its end everything written has been taken by the broker."""
        framer = Framer(packet_length)
        try:
            async with asyncio.timeout(_ANSWER_TIMEOUT_S):
                reader, writer = await asyncio.open_connection(*self._broker)
                try:
                    name = KIT_CLIENT.encode()
                    connect = b"\0\4MQTT\4\2\0\0" + len(name).to_bytes(2) + name
                    writer.write(_packet(0x10, connect))
                    if (answer := await _answer(reader, framer, 0x20))[-1] != 0:
                        raise KitError(f"the broker {self._url} refuses the kit with return code {answer[-1]}")
                    yield writer
                    # Packets are handled in order ([MQTT-4.6.0]): the answer to this one covers those before.
                    writer.write(_packet(0xC0, b""))
                    await _answer(reader, framer, 0xD0)
                    writer.write(_packet(0xE0, b""))
                    await writer.drain()
                finally:
                    writer.close()
        except TimeoutError:
            raise KitError(f"the broker {self._url} cannot be used: it does not answer") from None
        except ConnectionRefusedError:
            raise KitError(f"the broker {self._url} cannot be used: the port refuses connections") from None
        except (OSError, EOFError) as error:
            raise KitError(f"the broker {self._url} cannot be used: {error}") from None


def _packet(first: int, content: bytes) -> bytes:
    """A control packet (MQTT 3.1.1, section 2.2)."""
    length, digits = len(content), bytearray()
    while length > 127:
        digits.append(length & 127 | 128)
        length >>= 7
    return bytes([first, *digits, length]) + content


async def _answer(reader: asyncio.StreamReader, framer: Framer, kind: int) -> bytes:
    """The next packet of this kind; others in between are left alone."""
    while True:
        data = await reader.read(65536)
        if not data:
            raise EOFError("it closes the connection")
        for packet in framer.feed(data):
            if packet[0] & 0xF0 == kind:
                return packet
        if framer.malformed:
            raise EOFError(f"it does not speak MQTT: {framer.malformed}")
