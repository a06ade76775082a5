"""One network connection to the broker, from CONNECT to its end.

Every connection is a paho client of its own. paho keeps unacknowledged QoS 1 and 2 messages and sends them again after a
reconnect: a command that was reported as failed would be executed minutes later. A client that never reconnects cannot.

paho runs on the event loop through its socket callbacks; no thread, no locks, and an acknowledgement wakes its caller
directly.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode
from paho.mqtt.reasoncodes import ReasonCode

from ..core import AdapterError

__all__ = ["Connection", "ConnectionLostError", "Endpoint", "Message", "Will"]

KEEPALIVE_S = 10

# CONNACK return codes of 3.1.1 as paho names them (MQTT 5.0, 3.2.2.2).
_REFUSALS = {
    0x84: "config_error",
    0x85: "config_error",
    0x86: "auth_failed",
    0x87: "access_denied",
    0x88: "connect_failed",
}


class ConnectionLostError(Exception):
    """The connection ended before the broker's answer came."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoint:
    """Where the broker is and who we are."""

    host: str
    port: int
    tls: bool
    client_id: str
    username: str | None
    password: str | None
    timeout_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Will:
    """What the broker publishes when the connection breaks."""

    topic: str
    payload: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """A received message."""

    topic: str
    payload: bytes
    qos: int
    retain: bool


class Connection:
    """A connection that is open until :attr:`lost` is set."""

    def __init__(self, endpoint: Endpoint, on_message: Callable[[Message], None]) -> None:
        self._endpoint = endpoint
        self._on_message = on_message
        self._loop = asyncio.get_running_loop()
        self._opened: asyncio.Future[ReasonCode] = self._loop.create_future()
        self._answers: dict[int, asyncio.Future[list[ReasonCode]]] = {}
        self._early: dict[int, list[ReasonCode]] = {}
        self._housekeeping: asyncio.Task[None] | None = None
        self.lost = asyncio.Event()
        client = paho.Client(CallbackAPIVersion.VERSION2, client_id=endpoint.client_id, protocol=paho.MQTTv311)
        client.connect_timeout = endpoint.timeout_s
        if endpoint.username is not None:
            client.username_pw_set(endpoint.username, endpoint.password)
        if endpoint.tls:
            client.tls_set()
        client.on_connect = lambda c, u, flags, reason, p: self._set(self._opened, reason)
        client.on_disconnect = lambda c, u, flags, reason, p: self._end()
        client.on_message = lambda c, u, message: self._received(message)
        client.on_publish = lambda c, u, mid, reason, p: self._answer(mid, [reason])
        client.on_subscribe = lambda c, u, mid, reasons, p: self._answer(mid, reasons)
        client.on_unsubscribe = lambda c, u, mid, reasons, p: self._answer(mid, reasons)
        client.on_socket_open = self._socket_open
        client.on_socket_close = self._socket_close
        client.on_socket_register_write = lambda c, u, sock: self._soon(self._watch_write, sock)
        client.on_socket_unregister_write = lambda c, u, sock: self._soon(self._unwatch_write, sock)
        self._client = client

    # -- life ---------------------------------------------------------------------------------------------

    async def open(self, will: Will | None) -> None:
        """Connect and wait for the CONNACK.

        Raises:
            AdapterError: no connection, or the broker refuses.
        """
        endpoint = self._endpoint
        if will is not None:
            self._client.will_set(will.topic, will.payload, qos=1, retain=False)
        try:
            # The TCP and TLS handshakes block; everything after them runs on the loop.
            await asyncio.to_thread(self._client.connect, endpoint.host, endpoint.port, KEEPALIVE_S)
            reason = await asyncio.wait_for(self._opened, endpoint.timeout_s)
        except socket.gaierror:
            raise AdapterError("dns_error", "the broker's host name cannot be resolved", outcome="not_sent") from None
        except (OSError, ConnectionLostError):
            self._end()
            raise AdapterError(
                "connect_failed", "no connection to the broker could be made", outcome="not_sent"
            ) from None
        except TimeoutError:
            await self.close()
            raise AdapterError("timeout", "the broker did not answer CONNECT", outcome="not_sent") from None
        if reason.is_failure:
            await self.close()
            code = _REFUSALS.get(reason.value, "connect_failed")
            raise AdapterError(code, f"the broker refuses the connection ({reason})", outcome="not_sent")
        self._housekeeping = asyncio.create_task(self._keep_alive())

    async def _keep_alive(self) -> None:
        # paho sends its keep-alive, and finds out that the broker is silent, only when it is called.
        while self._client.loop_misc() == MQTTErrorCode.MQTT_ERR_SUCCESS:  # noqa: ASYNC110
            await asyncio.sleep(1.0)
        self._end()

    async def close(self) -> None:
        """Leave in an orderly way: the broker discards the will."""
        if self._housekeeping is not None:
            self._housekeeping.cancel()
        self._client.disconnect()
        # Bytes of the DISCONNECT may still wait for the socket.
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self.lost.wait(), 0.2)
        self._end()

    def _end(self) -> None:
        self.lost.set()
        if self._housekeeping is not None:
            self._housekeeping.cancel()
        pending: list[asyncio.Future[Any]] = [self._opened, *self._answers.values()]
        for waiting in pending:
            if not waiting.done():
                waiting.set_exception(ConnectionLostError())
                # Whoever gave up waiting must not cause a warning.
                waiting.exception()
        self._answers.clear()

    # -- paho on the loop ---------------------------------------------------------------------------------

    def _soon(self, function: Callable[[Any], None], sock: Any) -> None:
        # While connecting, paho calls from a worker thread.
        self._loop.call_soon_threadsafe(function, sock)

    def _socket_open(self, client: Any, userdata: Any, sock: Any) -> None:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._soon(self._watch_read, sock)

    def _watch_read(self, sock: Any) -> None:
        if sock.fileno() >= 0:
            self._loop.add_reader(sock, self._client.loop_read)

    def _watch_write(self, sock: Any) -> None:
        if sock.fileno() >= 0:
            self._loop.add_writer(sock, self._client.loop_write)

    def _unwatch_write(self, sock: Any) -> None:
        if sock.fileno() >= 0:
            self._loop.remove_writer(sock)

    def _socket_close(self, client: Any, userdata: Any, sock: Any) -> None:
        # Must happen before the descriptor is closed and can be given to another socket.
        self._loop.remove_reader(sock)
        self._loop.remove_writer(sock)

    def _set(self, future: asyncio.Future[Any], value: Any) -> None:
        if not future.done():
            future.set_result(value)

    def _received(self, message: Any) -> None:
        self._on_message(
            Message(topic=message.topic, payload=message.payload, qos=message.qos, retain=bool(message.retain))
        )

    # -- exchanges ----------------------------------------------------------------------------------------

    def _answer(self, mid: int, reasons: list[ReasonCode]) -> None:
        waiting = self._answers.pop(mid, None)
        if waiting is None:
            # A QoS 0 message is "published" before publish() has returned its number.
            self._early[mid] = reasons
        else:
            self._set(waiting, reasons)

    async def _await_answer(self, mid: int) -> list[ReasonCode]:
        if mid in self._early:
            return self._early.pop(mid)
        waiting = self._answers[mid] = self._loop.create_future()
        if self.lost.is_set():
            raise ConnectionLostError
        try:
            return await asyncio.wait_for(waiting, self._endpoint.timeout_s)
        except TimeoutError:
            raise AdapterError("timeout", f"no acknowledgement within {self._endpoint.timeout_s:g} s") from None
        finally:
            self._answers.pop(mid, None)

    def send(self, topic: str, payload: bytes, qos: int, retain: bool) -> int:
        """Hand a message to the socket and return its number; nothing is kept when the connection is down.

        Raises:
            ConnectionLostError: the connection is down; the message has not been sent.
        """
        if self.lost.is_set() or not self._client.is_connected():
            raise ConnectionLostError
        info = self._client.publish(topic, payload, qos, retain)
        if info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS:
            raise ConnectionLostError
        return int(info.mid)

    async def sent(self, mid: int) -> None:
        """Wait until the message is written (QoS 0) or acknowledged (QoS 1 and 2).

        Raises:
            ConnectionLostError: the connection broke first.
            AdapterError: ``timeout``.
        """
        await self._await_answer(mid)

    async def subscribe(self, text: str, qos: int) -> int:
        """Subscribe and return the granted QoS.

        Raises:
            ConnectionLostError: the connection broke.
            AdapterError: the broker refuses, or ``timeout``.
        """
        code, mid = self._client.subscribe(text, qos)
        if code != MQTTErrorCode.MQTT_ERR_SUCCESS or mid is None:
            raise ConnectionLostError
        (reason,) = await self._await_answer(mid)
        if reason.is_failure:
            raise AdapterError("access_denied", "the broker refuses the subscription", outcome="rejected")
        return int(reason.value)

    async def unsubscribe(self, text: str) -> None:
        """Unsubscribe and wait for the UNSUBACK; the broker answers for a filter that was never subscribed, too.

        Raises:
            ConnectionLostError: the connection broke.
            AdapterError: ``timeout``.
        """
        code, mid = self._client.unsubscribe(text)
        if code != MQTTErrorCode.MQTT_ERR_SUCCESS or mid is None:
            raise ConnectionLostError
        await self._await_answer(mid)
