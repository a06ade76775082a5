"""A device's own end of TLS, below every protocol of TCP: the device and its faults see plaintext, the journal has the handshakes.

The end is made of memory buffers: asyncio's own ``ssl=`` tells a protocol nothing of a handshake that fails, and keeps one certificate as
long as it listens. Here each new connection gets the certificate of that moment. A folder holds them: ``NAME.pem`` has a certificate with its
key, ``ca.pem`` those that clients' certificates are verified with. A client may do without a certificate; the journal says so.

=================  =======================================================================================================================
``tls_open``       the handshake is complete: ``version``, ``cipher``, ``certificate`` (the name of the device's own), and of the client's
                   certificate ``subject`` and ``role`` (MODBUS/TCP Security, extension 1.3.6.1.4.1.50316.802.1), null without one
``tls_ended``      the connection ended before that: ``certificate``, and ``reason``, the word of OpenSSL for the alert or fault
``tls_alert``      the client ended an open connection by an alert: ``reason``
``tls_plaintext``  the client's first byte is that of no handshake: ``bytes`` that came, to which nothing is answered
=================  =======================================================================================================================

The poke ``{"tls": NAME}`` presents another certificate, or the same again, and cuts every connection. Two names are no certificates: ``nothing`` for a device
without TLS on the same port, where what a client says in plaintext is served, and ``old`` for one that speaks TLS 1.1 at most.
"""

from __future__ import annotations

import asyncio
import contextlib
import ssl
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

from cryptography import x509

from .journal import Journal
from .medium import Medium
from .peer import process_of

__all__ = ["Secure", "Tls"]

_NOTHING, _OLD, _USUAL = "nothing", "old", "server"
_HANDSHAKE = 0x16
"""Content type of the first record of a connection (RFC 8446, section 5.1)."""
_MOST_SHOWN = 8
"""Bytes in clear that the journal has: more of a CONNECT may hold a password."""
_ROLE = x509.ObjectIdentifier("1.3.6.1.4.1.50316.802.1")


class Secure(Protocol):
    """What is above an end: a protocol with a number for its connection."""

    number: int

    def connection_made(self, transport: asyncio.BaseTransport) -> None: ...
    def data_received(self, data: bytes) -> None: ...
    def eof_received(self) -> bool | None: ...
    def connection_lost(self, exc: Exception | None) -> None: ...
    def pause_writing(self) -> None: ...
    def resume_writing(self) -> None: ...


class Tls:
    """What a device presents to new connections.

    Args:
        folder: with the certificates.
        journal: of the device.
        network: that the connections come through; what it loses of a handshake, or holds back, is lost for good.
        numbers: of connections.

    Attributes:
        name: of the present certificate.
    """

    def __init__(self, folder: Path, journal: Journal, network: Medium, numbers: Iterator[int]) -> None:
        self.journal = journal
        self.network = network
        self.numbers = numbers
        self.name = _USUAL
        self._folder = folder
        self.context = self._made(_USUAL)

    @property
    def is_usual(self) -> bool:
        """Whether the present certificate is that of the start."""
        return self.name == _USUAL

    def present(self, name: str = _USUAL) -> None:
        """Present another certificate from now on.

        Raises:
            ValueError: there is none of this name.
        """
        if name not in (_NOTHING, _OLD) and not (self._folder / f"{name}.pem").is_file():
            raise ValueError(f"tls: there is no certificate {name!r}")
        self.context, self.name = self._made(name), name
        self.journal.event(connection=0, direction="out", kind="tls", origin="kit", certificate=name)

    def _made(self, name: str) -> ssl.SSLContext | None:
        if name == _NOTHING:
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        # A weak key, or an old version, is refused by OpenSSL itself on a level of security above 0.
        context.set_ciphers("ALL:@SECLEVEL=0")
        if name == _OLD:
            context.minimum_version, context.maximum_version = ssl.TLSVersion.MINIMUM_SUPPORTED, ssl.TLSVersion.TLSv1_1
        # A session that is resumed would hide that the certificate is another one.
        context.num_tickets = 0
        context.options |= ssl.OP_NO_TICKET
        context.load_cert_chain(self._folder / f"{_USUAL if name == _OLD else name}.pem")
        context.load_verify_locations(self._folder / "ca.pem")
        context.verify_mode = ssl.CERT_OPTIONAL
        return context

    def end(self, above: Secure) -> asyncio.Protocol:
        """Return what serves a new connection, below this protocol."""
        return _End(self, above)


class _End(asyncio.Protocol):
    """The device's end of one connection: first nothing has come, then a handshake, then it is open; or it is refused, or plain."""

    def __init__(self, tls: Tls, above: Secure) -> None:
        self._tls = tls
        self._above = above
        self._name = tls.name
        self._in, self._out = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._ssl = None if tls.context is None else tls.context.wrap_bio(self._in, self._out, server_side=True)
        self._state = "first"
        self._reason: str | None = None
        self._transport: asyncio.Transport
        self._number = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._number = next(self._tls.numbers)
        self._tls.journal.heard_of(self._number, process_of(transport))

    def _record(self, kind: str, **fields: Any) -> None:
        self._tls.journal.event(connection=self._number, direction="in", kind=kind, **fields)

    # -- what comes in ------------------------------------------------------------------------------------

    def data_received(self, data: bytes) -> None:
        if self._state in ("first", "handshake") and self._tls.network.condition != "open":
            self._state = "lost"
        if self._state == "lost":
            self._record("lost", count=len(data))
        if self._state == "first":
            self._begin(data)
        if self._state == "plain":
            self._above.data_received(data)
        elif self._state in ("handshake", "open"):
            self._in.write(data)
            self._go_on()

    def _begin(self, data: bytes) -> None:
        speaks_tls = data[0] == _HANDSHAKE
        if self._ssl is not None and speaks_tls:
            self._state = "handshake"
        elif self._ssl is None and not speaks_tls:
            self._state = "plain"
            self._opened(self._transport)
        else:
            if not speaks_tls:
                self._record("tls_plaintext", bytes=data[:_MOST_SHOWN].hex(), count=len(data))
            self._refuse("NO_TLS" if speaks_tls else "PLAINTEXT")

    def _refuse(self, reason: str | None) -> None:
        self._state, self._reason = "refused", reason
        self._transport.close()

    def _opened(self, transport: asyncio.Transport) -> None:
        self._above.number = self._number
        self._above.connection_made(transport)

    def _go_on(self) -> None:
        assert self._ssl is not None
        try:
            if self._state == "handshake":
                self._ssl.do_handshake()
                self._flush()
                self._state = "open"
                self._opened(_Transport(self._ssl, self._flush, self._transport))
                peer = self._ssl.getpeercert(binary_form=True)
                cipher = self._ssl.cipher()
                self._record(
                    "tls_open",
                    version=self._ssl.version(),
                    cipher=None if cipher is None else cipher[0],
                    certificate=self._name,
                    **_client(peer),
                )
            while data := self._ssl.read(65536):
                self._above.data_received(data)
        except ssl.SSLWantReadError:
            self._flush()
        except ssl.SSLError as error:
            # What is written here is the alert that says why.
            self._flush()
            if self._state == "open":
                self._record("tls_alert", reason=error.reason)
                self._transport.abort()
            else:
                self._refuse(error.reason)
        else:
            # An empty reading is the client's close_notify.
            self.eof_received()
            self._transport.close()

    def _flush(self) -> None:
        if pending := self._out.read():
            self._transport.write(pending)

    # -- the end ------------------------------------------------------------------------------------------

    def eof_received(self) -> bool | None:
        return self._above.eof_received() if self._state in ("open", "plain") else None

    def connection_lost(self, exc: Exception | None) -> None:
        if self._state in ("open", "plain"):
            self._above.connection_lost(exc)
        else:
            self._record("tls_ended", certificate=self._name, reason=self._reason)

    def pause_writing(self) -> None:
        if self._state in ("open", "plain"):
            self._above.pause_writing()

    def resume_writing(self) -> None:
        if self._state in ("open", "plain"):
            self._above.resume_writing()


class _Transport(asyncio.Transport):
    """The transport that is seen above an end: only what is written is another."""

    def __init__(self, end: ssl.SSLObject, flush: Callable[[], None], below: asyncio.Transport) -> None:
        super().__init__()
        self._ssl = end
        self._flush = flush
        self._below = below

    def write(self, data: Any) -> None:
        if not self._below.is_closing():
            self._ssl.write(data)
            self._flush()

    def _notify(self) -> None:
        """Say that nothing more comes (close_notify)."""
        # The client has not answered it yet, and need not.
        with contextlib.suppress(ssl.SSLError):
            self._ssl.unwrap()
        if not self._below.is_closing():
            self._flush()

    def write_eof(self) -> None:
        self._notify()
        self._below.write_eof()

    def close(self) -> None:
        self._notify()
        self._below.close()

    def can_write_eof(self) -> bool:
        return True

    def abort(self) -> None:
        self._below.abort()

    def is_closing(self) -> bool:
        return self._below.is_closing()

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return self._below.get_extra_info(name, default)

    def pause_reading(self) -> None:
        self._below.pause_reading()

    def resume_reading(self) -> None:
        self._below.resume_reading()

    def is_reading(self) -> bool:
        return self._below.is_reading()

    def get_write_buffer_size(self) -> int:
        return self._below.get_write_buffer_size()

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._below.set_write_buffer_limits(high, low)

    def get_protocol(self) -> asyncio.BaseProtocol:
        return self._below.get_protocol()


def _client(certificate: bytes | None) -> dict[str, str | None]:
    """Return who a client is by its certificate."""
    if certificate is None:
        return {"subject": None, "role": None}
    parsed = x509.load_der_x509_certificate(certificate)
    return {"subject": parsed.subject.rfc4514_string(), "role": _role(parsed)}


def _role(certificate: x509.Certificate) -> str | None:
    """Return the role of a client: the whole of a UTF8String, which has one byte of length up to 127."""
    for extension in certificate.extensions:
        if extension.oid == _ROLE:
            assert isinstance(extension.value, x509.UnrecognizedExtension)
            return extension.value.value[2:].decode("utf-8", "replace")
    return None
