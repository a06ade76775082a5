"""A small MQTT 3.1.1 client for the simulators of this room: a real connection to whatever broker there is."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from .codec import Kind, Packet, Reader, decode, encode

__all__ = ["Client"]


class Client(asyncio.Protocol):
    """Connects, subscribes with QoS 1, publishes with QoS 0 or 1.

    Args:
        on_message: called with (topic, payload) for every message received.
    """

    def __init__(self, on_message: Callable[[str, bytes], None]) -> None:
        self._on_message = on_message
        self._reader = Reader()
        self._transport: asyncio.Transport
        self._answers: asyncio.Queue[Packet] = asyncio.Queue()
        self._last_id = 0

    @classmethod
    async def connect(
        cls, host: str, port: int, client_id: str, on_message: Callable[[str, bytes], None], will: dict[str, Any] | None
    ) -> Client:
        """Open a connection with a clean session and no keep-alive.

        Raises:
            ConnectionError: the broker refuses.
        """
        loop = asyncio.get_running_loop()
        _, client = await loop.create_connection(lambda: cls(on_message), host, port)
        fields = {"client_id": client_id, "clean_start": True, "keepalive": 0, "will": will}
        client._send(Packet(Kind.CONNECT, fields))
        answer = await client._answers.get()
        if answer.kind != Kind.CONNACK or answer["reason_codes"] != [0]:
            raise ConnectionError(f"the broker refuses {client_id}")
        return client

    async def subscribe(self, *filters: str) -> None:
        """Subscribe and wait for the SUBACK."""
        wanted = [{"filter": text, "qos": 1} for text in filters]
        self._send(Packet(Kind.SUBSCRIBE, {"packet_id": self._next_id(), "filters": wanted}))
        await self._answers.get()

    def publish(self, topic: str, payload: bytes, *, qos: int = 0, retain: bool = False) -> None:
        """Publish; a QoS 1 acknowledgement is not waited for."""
        fields = {
            "topic": topic,
            "payload": payload,
            "qos": qos,
            "retain": retain,
            "dup": False,
            "packet_id": self._next_id() if qos else None,
        }
        self._send(Packet(Kind.PUBLISH, fields))

    def close(self) -> None:
        """Disconnect in an orderly way."""
        self._send(Packet(Kind.DISCONNECT))
        self._transport.close()

    def _next_id(self) -> int:
        self._last_id = self._last_id % 65535 + 1
        return self._last_id

    def _send(self, packet: Packet) -> None:
        self._transport.write(encode(packet, 4))

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        for first, body in self._reader.feed(data):
            packet = decode(first, body, 4)
            if packet.kind == Kind.PUBLISH:
                if packet["qos"] == 1:
                    self._send(Packet(Kind.PUBACK, {"packet_id": packet["packet_id"], "reason_codes": [0]}))
                self._on_message(packet["topic"], packet["payload"])
            elif packet.kind in (Kind.CONNACK, Kind.SUBACK):
                self._answers.put_nowait(packet)
