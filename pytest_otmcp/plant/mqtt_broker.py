"""A broker of the user's own as the MQTT device of a run, with the tap in front of it as the witness."""

from __future__ import annotations

import asyncio
import base64
import secrets
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import Any
from urllib.parse import urlsplit

from ..core.errors import KitError
from ..protocols.mqtt.decoder import MqttConversation
from ..protocols.mqtt.external import EXTERNAL
from ..protocols.protocol import Framing
from ..wire.framing import Framer
from ..wire.mqtt.primitives import packet_length
from .endpoint import Endpoint
from .tapped_device import TappedDevice

__all__ = ["TappedBroker"]

_KIT_CLIENT = "otmcp-kit"
_ANSWER_TIMEOUT_S = 5.0
_FRAMING = Framing(frame_length=packet_length, conversation=MqttConversation)


class TappedBroker(TappedDevice):
    """The broker at ``mqtt://host[:port]``, reached through a tap."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        host, port = parts.hostname or "127.0.0.1", parts.port or EXTERNAL.default_port
        super().__init__(f"broker {url}", Endpoint(name="mqtt", kind="tcp", host=host, port=port), _FRAMING)
        self._address = (host, port)

    async def check(self) -> None:
        """Make sure that the broker is there.

        Raises:
            KitError: it does not answer CONNECT.
        """
        async with self._connection():
            pass

    async def poke(self, **params: Any) -> None:
        """Publish past the tap; ``publish`` has ``topic``, ``payload`` (base64), ``qos`` (0 or 1) and ``retain``.

        It returns when the broker has accepted the message; the journal has it with origin ``kit``, on connection 0.

        Raises:
            KitError: something else was asked for, or the broker does not accept the message.
        """
        if set(params) != {"publish"}:
            raise KitError(f"the {self.noun} can be told to publish and nothing else, not {', '.join(params)}")
        publish: Mapping[str, Any] = params["publish"]
        topic, payload = str(publish["topic"]), base64.b64decode(publish["payload"])
        qos, retain = int(publish.get("qos", 0)), bool(publish.get("retain", False))
        text = topic.encode()
        identifier = b"\0\1" if qos else b""
        content = len(text).to_bytes(2) + text + identifier + payload
        fields = {"topic": topic, "payload": publish["payload"], "qos": qos, "retain": retain, "dup": False}
        self.tap.journal.event(0, "in", "PUBLISH", origin="kit", client_id=_KIT_CLIENT, **fields)
        async with self._connection() as writer:
            writer.write(_packet(0x30 | qos << 1 | retain, content))

    @asynccontextmanager
    async def _connection(self) -> AsyncIterator[asyncio.StreamWriter]:
        """Open a connection of the kit's own; when it ends, the broker has handled everything written."""
        framer = Framer(packet_length)
        try:
            async with asyncio.timeout(_ANSWER_TIMEOUT_S):
                reader, writer = await asyncio.open_connection(*self._address)
                try:
                    # A broker ends a connection when another client connects with the same name ([MQTT-3.1.4-2]), and the kit
                    # may have several connections to one broker at a time.
                    name = f"{_KIT_CLIENT}-{secrets.token_hex(4)}".encode()
                    connect = b"\0\4MQTT\4\2\0\0" + len(name).to_bytes(2) + name
                    writer.write(_packet(0x10, connect))
                    if (answer := await _answer(reader, framer, 0x20))[-1] != 0:
                        raise KitError(f"the {self.noun} refuses the kit with return code {answer[-1]}")
                    yield writer
                    # Packets are handled in order ([MQTT-4.6.0]): the answer to this packet covers the earlier ones.
                    writer.write(_packet(0xC0, b""))
                    await _answer(reader, framer, 0xD0)
                    writer.write(_packet(0xE0, b""))
                    await writer.drain()
                finally:
                    writer.close()
        except TimeoutError:
            raise KitError(f"the {self.noun} cannot be used: it does not answer") from None
        except ConnectionRefusedError:
            raise KitError(f"the {self.noun} cannot be used: the port refuses connections") from None
        except (OSError, EOFError) as error:
            raise KitError(f"the {self.noun} cannot be used: {error}") from None


def _packet(first: int, content: bytes) -> bytes:
    """Return a control packet (MQTT 3.1.1, section 2.2)."""
    length, digits = len(content), bytearray()
    while length > 127:
        digits.append(length & 127 | 128)
        length >>= 7
    return bytes([first, *digits, length]) + content


async def _answer(reader: asyncio.StreamReader, framer: Framer, kind: int) -> bytes:
    """Return the next packet of this kind; others in between are ignored."""
    while True:
        data = await reader.read(65536)
        if not data:
            raise EOFError("it closes the connection")
        for packet in framer.feed(data):
            if packet[0] & 0xF0 == kind:
                return packet
        if framer.malformed:
            raise EOFError(f"it does not speak MQTT: {framer.malformed}")
