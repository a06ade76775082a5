"""A small MQTT 3.1.1 client for the simulated plant: a real connection to any broker."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable

from pytest_otmcp.wire.mqtt.codec import decode, encode
from pytest_otmcp.wire.mqtt.packets import (
    MQTT_311,
    Ack,
    Connack,
    Connect,
    Disconnect,
    Packet,
    PacketType,
    Pingreq,
    Publish,
    Suback,
    Subscribe,
    SubscriptionRequest,
)
from pytest_otmcp.wire.mqtt.primitives import ProtocolViolation

from ..journal import Direction
from .framer import Framer

__all__ = ["Client", "Dial", "Observer"]

Observer = Callable[[Direction, bytes], None]
"""Function that is called with the bytes of every packet and its direction, ``in`` or ``out``."""

Dial = Callable[[], Awaitable[socket.socket]]
"""Function that returns a stream socket with the broker at its other end, or raises an OSError."""

_ANSWER_TIMEOUT_S = 5.0


class Client(asyncio.Protocol):
    """A client that subscribes with QoS 1 and publishes with QoS 0 or 1; one subscribe and one ping at a time.

    Attributes:
        closed: set when the connection has ended.
    """

    def __init__(self, on_message: Callable[[Publish], None], observe: Observer) -> None:
        self._on_message = on_message
        self._observe = observe
        self._framer = Framer()
        self._transport: asyncio.Transport
        self._answers: dict[PacketType, asyncio.Future[Packet]] = {}
        self._last_id = 0
        self.closed = asyncio.Event()

    @classmethod
    async def connect(
        cls, dial: Dial, connect: Connect, on_message: Callable[[Publish], None], observe: Observer
    ) -> Client:
        """Open a connection.

        Raises:
            OSError: there is no broker, or it refuses or does not answer.
        """
        loop = asyncio.get_running_loop()
        _, client = await loop.create_connection(lambda: cls(on_message, observe), sock=await dial())
        answer = await client._ask(connect, PacketType.CONNACK)
        assert isinstance(answer, Connack)
        if answer.reason_code:
            client._transport.abort()
            raise ConnectionRefusedError(f"the broker refuses {connect.client_id} with code {answer.reason_code}")
        return client

    async def subscribe(self, *filters: str) -> None:
        """Subscribe with QoS 1.

        Raises:
            OSError: the broker refuses, or the connection ends.
        """
        requests = tuple(SubscriptionRequest(filter=one, qos=1) for one in filters)
        answer = await self._ask(Subscribe(packet_id=self._next_id(), requests=requests), PacketType.SUBACK)
        assert isinstance(answer, Suback)
        if 0x80 in answer.reason_codes:
            self._transport.abort()
            raise ConnectionRefusedError(f"the broker refuses a subscription: {answer.reason_codes}")

    def publish(self, topic: str, payload: bytes, *, qos: int = 0, retain: bool = False) -> None:
        """Publish without waiting for a QoS 1 acknowledgement."""
        packet_id = self._next_id() if qos else 0
        self._send(Publish(topic=topic, payload=payload, qos=qos, retain=retain, packet_id=packet_id))

    async def ping(self) -> None:
        """Wait until the broker has handled everything sent so far.

        Raises:
            OSError: the connection ends.
        """
        await self._ask(Pingreq(), PacketType.PINGRESP)

    def cut(self) -> None:
        """End the connection without DISCONNECT: the broker publishes the will."""
        self._transport.abort()

    async def aclose(self) -> None:
        """Disconnect in an orderly way."""
        self._send(Disconnect())
        self._transport.close()
        await self.closed.wait()

    async def _ask(self, packet: Packet, answer: PacketType) -> Packet:
        waiting = self._answers[answer] = asyncio.get_running_loop().create_future()
        if self.closed.is_set():
            raise ConnectionResetError("the connection to the broker has ended")
        self._send(packet)
        try:
            return await asyncio.wait_for(waiting, _ANSWER_TIMEOUT_S)
        except TimeoutError:
            self._transport.abort()
            raise

    def _next_id(self) -> int:
        self._last_id = self._last_id % 65_535 + 1
        return self._last_id

    def _send(self, packet: Packet) -> None:
        if not self._transport.is_closing():
            frame = encode(packet, MQTT_311)
            self._observe("out", frame)
            self._transport.write(frame)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def connection_lost(self, exc: Exception | None) -> None:
        self.closed.set()
        for waiting in self._answers.values():
            if not waiting.done():
                waiting.set_exception(ConnectionResetError("the broker closed the connection"))

    def data_received(self, data: bytes) -> None:
        self._framer.feed(data)
        try:
            while frame := self._framer.next():
                self._observe("in", self._framer.frame)
                self._received(decode(*frame, MQTT_311))
        except ProtocolViolation:
            self._transport.abort()

    def _received(self, packet: Packet) -> None:
        waiting = self._answers.get(packet.type)
        if waiting is not None and not waiting.done():
            waiting.set_result(packet)
        elif isinstance(packet, Publish):
            if packet.qos == 1:
                self._send(Ack(type=PacketType.PUBACK, packet_id=packet.packet_id))
            self._on_message(packet)
