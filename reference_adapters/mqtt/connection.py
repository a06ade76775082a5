"""One network connection to the broker, from CONNECT to its end.

Every connection is a paho client of its own. paho keeps unacknowledged messages of QoS 1 and 2 and sends them again after
a reconnect: a command that was reported as failed would be executed minutes later. A client that never reconnects sends
nothing again.

paho runs on the event loop: no thread, no locks, and an acknowledgement wakes its caller directly. Of paho's callbacks for
event loops only ``on_socket_close`` is used. With ``on_socket_register_write`` and the others paho would leave every packet
to the loop; without them it writes the packet at once, and the caller knows whether it has left.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import select
import socket
import ssl
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode
from paho.mqtt.reasoncodes import ReasonCode

from ..core import AdapterError, Lost, handshake_failure

__all__ = ["VERSIONS", "Connection", "Delivery", "Endpoint", "Message", "Refused", "Will", "refusal_code"]

VERSIONS = {"5": paho.MQTTv5, "3.1.1": paho.MQTTv311}
"""The versions of MQTT that the adapter speaks. A broker for 3.1.1 cannot refuse a message: what it acknowledges it may have dropped."""

# A half-open connection is detected after two of these periods.
KEEPALIVE_S = 5
# An orderly DISCONNECT must not delay the end of the process for longer than this.
_FAREWELL_S = 2.0
# Number of packets that are read before one is sent; a flood of messages must not keep the adapter from sending.
_CATCH_UP = 100

_ABORT = struct.pack("ii", 1, 0)
_PROTOCOL_ERROR = 0x82

# Reason codes of MQTT 5 (section 2.4), by which paho also names the CONNACK return codes of 3.1.1.
_REFUSALS = {
    0x81: "protocol_error",
    0x82: "protocol_error",
    0x83: "device_failure",
    0x84: "config_error",
    0x85: "config_error",
    0x86: "auth_failed",
    0x87: "access_denied",
    0x89: "device_busy",
    0x8A: "access_denied",
    0x8C: "auth_failed",
    0x8F: "invalid_input",
    0x90: "invalid_input",
    0x91: "protocol_error",
    0x92: "protocol_error",
    0x93: "rate_limited",
    0x95: "limit_exceeded",
    0x96: "rate_limited",
    0x97: "rate_limited",
    0x99: "invalid_input",
    0x9A: "unsupported_operation",
    0x9B: "unsupported_operation",
    0x9E: "unsupported_operation",
    0x9F: "rate_limited",
    0xA2: "unsupported_operation",
}

# These do not say whether the broker has the message.
_UNDECIDED = (0x80, 0x81, 0x82, 0x83, 0x91, 0x92)

log = logging.getLogger(__name__)


class Refused(AdapterError):
    """The broker refuses a message."""

    def __init__(self, reason: int) -> None:
        code, outcome = (
            refusal_code(reason, otherwise="device_failure"),
            "unknown" if reason in _UNDECIDED else "rejected",
        )
        super().__init__(code, "the broker refuses the message", outcome=outcome, details={"by": "device"})
        self.reason = reason


def refusal_code(reason: int, *, otherwise: str) -> str:
    """Return the error code for a reason code with which a broker refuses."""
    return _REFUSALS.get(reason, otherwise)


@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoint:
    """The broker's address, and the identity of this client.

    Attributes:
        tls: for a connection over TLS; None for one in clear.
        version: of MQTT, one of :data:`VERSIONS`.
        timeout_s: seconds for connecting, and for each answer of the broker.
    """

    host: str
    port: int
    tls: ssl.SSLContext | None
    version: str
    client_id: str
    username: str | None
    password: str | None
    timeout_s: float

    @property
    def uri(self) -> str:
        """The endpoint's URI without credentials."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'mqtts' if self.tls else 'mqtt'}://{host}:{self.port}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """A message received, or to be published."""

    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Will:
    """The message that the broker publishes, with QoS 1 and not retained, when the connection breaks."""

    topic: str
    payload: bytes


class Delivery:
    """A message on its way.

    Attributes:
        packet_id: packet identifier of QoS 1 and 2; paho numbers messages of QoS 0, too.
        done: None if the message was written (QoS 0) at once; else set when written, or acknowledged (QoS 1 and 2).
    """

    __slots__ = ("_info", "done", "packet_id")

    def __init__(self, info: paho.MQTTMessageInfo, loop: asyncio.AbstractEventLoop) -> None:
        self._info = info
        self.packet_id = info.mid
        self.done: asyncio.Future[None] | None = None if info.is_published() else loop.create_future()

    def refuse(self, reason: int) -> None:
        """Tell the caller that the broker refuses the message; for paho it is published all the same."""
        if self.done is not None and not self.done.done():
            self.done.set_exception(Refused(reason))
            # It is retrieved here, so that asyncio does not warn about an exception that no caller awaits.
            self.done.exception()

    def settle(self) -> bool:
        """Wake the caller if paho has written the message or has its acknowledgement; return whether this is so."""
        if not self._info.is_published():
            return False
        if self.done is not None and not self.done.done():
            self.done.set_result(None)
        return True


class Connection:
    """A connection that lasts until :attr:`lost` is set, and is never opened again.

    Attributes:
        lost: set when the connection has ended.
        introduced: True when a CONNECT was sent.
    """

    def __init__(self, endpoint: Endpoint, on_message: Callable[[Message], None]) -> None:
        self.lost = asyncio.Event()
        self.introduced = False
        self._endpoint = endpoint
        self._on_message = on_message
        self._loop = asyncio.get_running_loop()
        self._opened: asyncio.Future[ReasonCode] = self._loop.create_future()
        self._answers: dict[int, asyncio.Future[Any]] = {}
        self._deliveries: list[Delivery] = []
        self._housekeeping: asyncio.Task[None] | None = None
        self._poll = select.poll()
        self._descriptor = -1
        self._writing = False
        # Without reconnect_on_failure=False paho answers a refusal of 3.1.1 by a blocking attempt with 3.1.
        client = paho.Client(
            CallbackAPIVersion.VERSION2,
            endpoint.client_id,
            protocol=VERSIONS[endpoint.version],
            reconnect_on_failure=False,
        )
        client.connect_timeout = endpoint.timeout_s
        # paho's limit of 20 would hold messages back and send them later, perhaps after their failure was reported.
        client.max_inflight_messages_set(0)
        if endpoint.username is not None:
            client.username_pw_set(endpoint.username, endpoint.password)
        if endpoint.tls is not None:
            client.tls_set_context(endpoint.tls)
        client.on_connect = lambda c, u, flags, reason, p: self._accepted(reason)
        client.on_disconnect = lambda c, u, flags, reason, p: self._ended(reason)
        client.on_message = lambda c, u, message: self._received(message)
        client.on_subscribe = lambda c, u, mid, reasons, p: self._answer(mid, reasons)
        client.on_unsubscribe = lambda c, u, mid, reasons, p: self._answer(mid, reasons)
        client.on_socket_close = lambda c, u, sock: self._unwatch()
        self._client = client

    # -- life ---------------------------------------------------------------------------------------------

    async def open(self, will: Will | None) -> None:
        """Connect and wait for the CONNACK.

        Raises:
            AdapterError: no connection, or the broker refuses; outcome ``not_sent``.
        """
        endpoint = self._endpoint
        if will is not None:
            self._client.will_set(will.topic, will.payload, qos=1, retain=False)
        try:
            # The TCP and TLS handshakes block; everything after them runs on the loop.
            await asyncio.to_thread(self._client.connect, endpoint.host, endpoint.port, KEEPALIVE_S)
            self.introduced = True
            self._watch()
            async with asyncio.timeout(endpoint.timeout_s):
                reason = await self._opened
        except (OSError, Lost) as error:
            self.abort()
            raise self._no_connection(error) from None
        except BaseException:
            self.abort()
            raise
        if reason.is_failure:
            self.abort()
            code = refusal_code(reason.value, otherwise="connect_failed")
            raise AdapterError(code, "the broker refuses the connection", outcome="not_sent")
        self._housekeeping = asyncio.create_task(self._keep_alive())

    def _no_connection(self, error: Exception) -> AdapterError:
        failure = None if self._endpoint.tls is None else handshake_failure(error, "broker")
        if failure is not None and not self.introduced:
            return failure
        code, message = "connect_failed", f"no connection to {self._endpoint.uri}; is the broker running there?"
        if isinstance(error, socket.gaierror):
            code, message = "dns_error", "the broker's host name cannot be resolved"
        elif isinstance(error, TimeoutError) and self.introduced:
            code, message = "timeout", "the broker did not answer CONNECT"
        return AdapterError(code, message, outcome="not_sent")

    async def _keep_alive(self) -> None:
        # paho sends its PINGREQ, and finds out that the broker is silent, only when it is called.
        while self._client.loop_misc() == MQTTErrorCode.MQTT_ERR_SUCCESS:
            self._flush()
            await asyncio.sleep(1.0)

    def abort(self) -> None:
        """End the connection now, without DISCONNECT, so that the broker publishes the will.

        Nothing that was handed over before is sent any more: neither the data in paho nor that in the kernel.
        """
        sock = self._socket()
        if sock is not None:
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _ABORT)
        # This closes the socket and forgets every message.
        self._client.reinitialise()
        self._end()

    async def close(self) -> None:
        """Disconnect in an orderly way: the broker discards the will."""
        self._client.disconnect()
        self._flush()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_FAREWELL_S):
                await self.lost.wait()
        self.abort()

    def is_live(self) -> bool:
        """Read the packets that have arrived, and return whether the connection still exists."""
        for _ in range(_CATCH_UP):
            if self.lost.is_set() or not self._poll.poll(0):
                break
            self._read()
        return not self.lost.is_set()

    def _accepted(self, reason: ReasonCode) -> None:
        if not self._opened.done():
            self._opened.set_result(reason)

    def _ended(self, reason: ReasonCode) -> None:
        if reason.value == _PROTOCOL_ERROR and not self._opened.done():
            # paho reports return code 1, unacceptable protocol version, and every unexpected packet like this.
            message = f"what answers there is no broker for MQTT {self._endpoint.version}; see MQTT_VERSION"
            self._opened.set_exception(AdapterError("config_error", message, outcome="not_sent"))
        self._end()

    def _end(self) -> None:
        self.lost.set()
        if self._housekeeping is not None:
            self._housekeeping.cancel()
        self._settle()
        for waiting in (self._opened, *self._answers.values(), *(one.done for one in self._deliveries)):
            if waiting is not None and not waiting.done():
                waiting.set_exception(Lost())
                # It is retrieved here, so that asyncio does not warn about an exception that no caller awaits.
                waiting.exception()
        self._answers.clear()
        self._deliveries.clear()

    # -- paho on the loop ---------------------------------------------------------------------------------

    def _socket(self) -> socket.socket | None:
        # paho also has WebSockets, and therefore a type of its own for what it returns here.
        return cast(socket.socket | None, self._client.socket())

    def _watch(self) -> None:
        sock = self._socket()
        if sock is None:
            raise Lost
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._descriptor = sock.fileno()
        self._poll.register(self._descriptor, select.POLLIN)
        self._loop.add_reader(self._descriptor, self._read)

    def _unwatch(self) -> None:
        # This must happen before the descriptor is closed, because another socket can get the same descriptor.
        if self._descriptor >= 0:
            self._loop.remove_reader(self._descriptor)
            self._loop.remove_writer(self._descriptor)

    def _read(self) -> None:
        sock = self._socket()
        try:
            self._client.loop_read()
            # Data that TLS has already decrypted does not make the socket readable.
            while isinstance(sock, ssl.SSLSocket) and self._socket() is sock and sock.pending():
                self._client.loop_read()
        except Exception:
            # paho raises for some packets that a broker must not send.
            log.warning("the broker sent what is not MQTT; the connection is dropped", exc_info=True)
            self.abort()
        self._flush()

    def _flush(self) -> None:
        """Write the packets that paho still holds: now as far as possible, the rest when the socket is writable."""
        if self._client.want_write():
            self._client.loop_write()
        self._settle()
        if self._client.socket() is None or self._client.want_write() == self._writing:
            return
        self._writing = not self._writing
        if self._writing:
            self._loop.add_writer(self._descriptor, self._flush)
        else:
            self._loop.remove_writer(self._descriptor)

    def _settle(self) -> None:
        if self._deliveries:
            self._deliveries = [one for one in self._deliveries if not one.settle()]

    def _published(self, packet_id: int, reason: ReasonCode) -> None:
        if reason.is_failure:
            for delivery in self._deliveries:
                if delivery.packet_id == packet_id:
                    delivery.refuse(reason.value)

    def _received(self, message: Any) -> None:
        self._on_message(
            Message(topic=message.topic, payload=message.payload, qos=message.qos, retain=bool(message.retain))
        )

    def _answer(self, mid: int, reasons: Sequence[ReasonCode]) -> None:
        waiting = self._answers.pop(mid, None)
        if waiting is not None and not waiting.done():
            waiting.set_result(reasons)

    # -- exchanges ----------------------------------------------------------------------------------------

    def send(self, message: Message) -> Delivery:
        """Hand a message to the socket at once, or fail.

        Raises:
            Lost: the connection broke.
        """
        if message.qos:
            # With it paho makes a reason code and properties for each message, which doubles the cost of one with QoS 0.
            self._client.on_publish = lambda c, u, mid, reason, p: self._published(mid, reason)
        info = self._client.publish(message.topic, message.payload, message.qos, message.retain)
        if info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS:
            self.abort()
            raise Lost
        delivery = Delivery(info, self._loop)
        if delivery.done is not None:
            self._deliveries.append(delivery)
            self._flush()
        return delivery

    async def delivered(self, deliveries: Sequence[Delivery]) -> None:
        """Wait until the messages are written (QoS 0) or acknowledged (QoS 1 and 2).

        Raises:
            Lost: the connection broke first.
            Refused: the broker refuses one of them.
            AdapterError: ``timeout``.
        """
        pending = [one.done for one in deliveries if one.done is not None]
        if not pending:
            return
        try:
            async with asyncio.timeout(self._endpoint.timeout_s):
                for done in pending:
                    await done
        except TimeoutError:
            # Else unwritten bytes and the PUBREL of a QoS 2 message would be sent after the failure was reported.
            self.abort()
            raise self._silence() from None
        except asyncio.CancelledError:
            self.abort()
            raise

    def _silence(self) -> AdapterError:
        return AdapterError("timeout", f"the broker did not answer within {self._endpoint.timeout_s:g} s")

    async def _answered(self, request: tuple[MQTTErrorCode, int | None]) -> Sequence[ReasonCode]:
        code, mid = request
        if code != MQTTErrorCode.MQTT_ERR_SUCCESS or mid is None:
            self.abort()
            raise Lost
        answer = self._answers[mid] = self._loop.create_future()
        self._flush()
        try:
            async with asyncio.timeout(self._endpoint.timeout_s):
                reasons: Sequence[ReasonCode] = await answer
                return reasons
        except TimeoutError:
            # A broker that does not answer counts as gone, even if TCP still has the connection.
            self.abort()
            raise self._silence() from None
        finally:
            self._answers.pop(mid, None)

    async def subscribe(self, filters: Mapping[str, int]) -> list[int]:
        """Subscribe to filters with the QoS asked for; return the reason code of each: the granted QoS, or 0x80 and above.

        Raises:
            Lost: the connection broke.
            AdapterError: ``timeout``, or ``protocol_error``: the answer is about another number of filters [MQTT-3.8.4-5].
        """
        reasons = await self._answered(self._client.subscribe(list(filters.items())))
        if len(reasons) != len(filters):
            self.abort()
            raise AdapterError("protocol_error", "the broker's answer does not fit the subscription")
        return [int(reason.value) for reason in reasons]

    async def unsubscribe(self, text: str) -> None:
        """Unsubscribe and wait for the UNSUBACK; the broker answers it for a filter that was never subscribed, too.

        Raises:
            Lost: the connection broke.
            AdapterError: ``timeout``.
        """
        await self._answered(self._client.unsubscribe(text))
