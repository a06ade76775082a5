"""Defects that the checks of the area TLS notice."""

from __future__ import annotations

import dataclasses
import datetime
import os
import ssl
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ...core import AdapterError, AdapterServer, Call, ConfigError, Environment
from ...opcua.security import Security, _has_issued
from ..defect import Change, Defect, defect, failing

__all__ = ["DEFECTS"]

_NO_CHECK_TIME = 0x200000
"""X509_V_FLAG_NO_CHECK_TIME of OpenSSL, for which Python has no name."""
_EVERY = "TLS-001 TLS-002 TLS-003"


def _link(server: AdapterServer) -> Any:
    """Return the adapter's connection to its device, whatever the protocol."""
    return server._close.__self__


def _context(link: Any) -> ssl.SSLContext | None:
    context: ssl.SSLContext | None = link.endpoint.tls if hasattr(link, "endpoint") else link._tls
    return context


def _use(link: Any, context: ssl.SSLContext | None) -> None:
    if hasattr(link, "endpoint"):
        link.endpoint = dataclasses.replace(link.endpoint, tls=context)
    else:
        link._tls = context


def _weakened(change: Callable[[ssl.SSLContext], None]) -> Change:
    """Return the defect that the context for secure connections is another one."""

    def apply(server: AdapterServer) -> None:
        if (context := _context(_link(server))) is not None:
            change(context)

    return apply


@_weakened
def trusts_everybody(context: ssl.SSLContext) -> None:
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE


@_weakened
def any_host(context: ssl.SSLContext) -> None:
    context.check_hostname = False


@_weakened
def no_clock(context: ssl.SSLContext) -> None:
    context.verify_flags |= ssl.VerifyFlags(_NO_CHECK_TIME)


@_weakened
def old_and_weak(context: ssl.SSLContext) -> None:
    context.set_ciphers("DEFAULT:@SECLEVEL=0")
    context.minimum_version = ssl.TLSVersion.MINIMUM_SUPPORTED


def in_clear(server: AdapterServer) -> None:
    _use(_link(server), None)


def in_clear_when_refused(server: AdapterServer) -> None:
    link = _link(server)
    genuine, context = link._connect, _context(link)

    async def connect(*arguments: Any) -> Any:
        try:
            return await genuine(*arguments)
        except AdapterError as error:
            if error.code != "tls_error":
                raise
            _use(link, None)
            try:
                return await genuine(*arguments)
            finally:
                _use(link, context)

    link._connect = connect


def _nameless(prefix: str) -> ssl.SSLContext:
    return ssl.create_default_context(cafile=os.environ[f"{prefix}_TLS_CA"])


def nameless(prefix: str) -> Change:
    """Return the defect that the adapter's own certificate is read and not presented."""

    def apply(server: AdapterServer) -> None:
        if _context(_link(server)) is not None:
            _use(_link(server), _nameless(prefix))

    return apply


def nameless_when_unreadable(protocol: str) -> Callable[[], None]:
    """Return what lets an adapter start without its own certificate where that cannot be read."""

    def patch() -> None:
        adapter: Any = import_module(f"...{protocol}.adapter", __package__)
        genuine = adapter.client_context

        def lenient(environment: Environment, prefix: str, **more: Any) -> ssl.SSLContext | None:
            try:
                context: ssl.SSLContext | None = genuine(environment, prefix, **more)
            except ConfigError:
                return _nameless(prefix)
            return context

        adapter.client_context = lenient

    return patch


def _nothing(server: AdapterServer) -> None:
    pass


def _refused_to_the_role(code: str, message: str) -> Change:
    def change(call: Call, error: AdapterError) -> Exception | None:
        if error.code != "access_denied":
            return None
        return AdapterError(code, message, outcome=error.outcome)

    return failing(change=change)


def any_server(server: AdapterServer) -> None:
    Security._faults = lambda security, certificate, application: iter(())


def any_server_of_the_issuer(server: AdapterServer) -> None:
    Security._faults = lambda security, certificate, application: iter(
        () if any(_has_issued(one, certificate) for one in security.believed) else ("its issuer is unknown",)
    )


def without_security(server: AdapterServer) -> None:
    _link(server).security = None


def without_security_when_refused(server: AdapterServer) -> None:
    link = _link(server)
    genuine, security = link._connect, link.security

    async def connect(call: Call) -> Any:
        try:
            return await genuine(call)
        except AdapterError as error:
            if error.code != "tls_error":
                raise
            link.security = None
            try:
                return await genuine(call)
            finally:
                link.security = security

    link._connect = connect


def _self_made(application: str) -> tuple[bytes, bytes]:
    """Return a certificate that has signed itself, and its key, as PEM."""
    key = rsa.generate_private_key(65537, 2048)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "self-made")])
    now = datetime.datetime.now(datetime.UTC)
    usage = dict.fromkeys(
        ("key_cert_sign", "crl_sign", "key_agreement", "encipher_only", "decipher_only"), False
    ) | dict.fromkeys(("digital_signature", "content_commitment", "key_encipherment", "data_encipherment"), True)
    certificate = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now)
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.UniformResourceIdentifier(application)]), critical=False)
        .add_extension(x509.KeyUsage(**usage), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH]), critical=False)
        .sign(key, hashes.SHA256())
    )
    form = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    private = key.private_bytes(serialization.Encoding.PEM, *form)
    return certificate.public_bytes(serialization.Encoding.PEM), private


def another_certificate(server: AdapterServer) -> None:
    """Present a certificate that the adapter has made itself."""
    link = _link(server)
    if link.security is not None:
        certificate, key = _self_made(link.security.application)
        link.security = dataclasses.replace(link.security, certificate=certificate, key=key)


def another_certificate_when_unreadable() -> None:
    """Make a certificate where the adapter's own cannot be read."""
    genuine = Security.of

    def lenient(environment: Environment, host: str) -> Security | None:
        try:
            return genuine(environment, host)
        except ConfigError:
            for name, content in zip(("OPCUA_CERT", "OPCUA_KEY"), _self_made("urn:otmcp-adapter"), strict=True):
                Path(os.environ[name]).write_bytes(content)
            return genuine(environment, host)

    Security.of = lenient


def one_policy() -> None:
    """Take no notice of the policy that is set."""
    if "OPCUA_SECURITY_POLICY" in os.environ:
        os.environ["OPCUA_SECURITY_POLICY"] = "Basic256Sha256"


def signed_alone(server: AdapterServer) -> None:
    """Encrypt nothing."""
    from asyncua import ua

    link = _link(server)
    if link.security is not None:
        link.security = dataclasses.replace(link.security, mode=ua.MessageSecurityMode.Sign)


DEFECTS: tuple[Defect, ...] = (
    defect(
        "MU-96c",
        "opcua",
        "A server that is to be reached securely is reached without security.",
        without_security,
        _EVERY,
        "TLS-001",
    ),
    defect("MU-97i", "opcua", "Certificates are not verified.", any_server, "TLS-002"),
    defect("MU-97k", "opcua", "Of a certificate the issuer alone is verified.", any_server_of_the_issuer, "TLS-002"),
    defect(
        "MU-98i",
        "opcua",
        "Where security cannot be agreed on, there is none.",
        without_security_when_refused,
        "TLS-001 TLS-002",
        "TLS-001",
    ),
    defect(
        "MU-96",
        "modbus",
        "A device that is to be reached by TLS is reached without.",
        in_clear,
        f"{_EVERY} TLS-004",
        "TLS-001",
    ),
    defect("MU-96b", "mqtt", "A broker that is to be reached by TLS is reached without.", in_clear, _EVERY, "TLS-001"),
    defect("MU-97", "modbus", "Certificates are not verified.", trusts_everybody, "TLS-002"),
    defect("MU-97b", "modbus", "The certificate may be of any host.", any_host, "TLS-002"),
    defect("MU-97c", "modbus", "The certificate may have expired, or not be valid yet.", no_clock, "TLS-002"),
    defect("MU-97d", "modbus", "TLS 1.1 and short keys are good enough.", old_and_weak, "TLS-002"),
    defect("MU-97e", "mqtt", "Certificates are not verified.", trusts_everybody, "TLS-002"),
    defect("MU-97f", "mqtt", "The certificate may be of any host.", any_host, "TLS-002"),
    defect("MU-97g", "dnp3", "The certificate may be of any host.", any_host, "TLS-002"),
    defect("MU-97h", "ethernetip", "Certificates are not verified.", trusts_everybody, "TLS-002"),
    defect(
        "MU-98",
        "modbus",
        "Where TLS cannot be agreed on, the device is reached without.",
        in_clear_when_refused,
        "TLS-001 TLS-002",
        "TLS-001",
    ),
    defect(
        "MU-98b",
        "modbus",
        "The adapter's own certificate is read, and not presented.",
        nameless("MODBUS"),
        "TLS-003",
        "TLS-003 TLS-004",
    ),
    defect(
        "MU-98c",
        "modbus",
        "Where the adapter's own certificate cannot be read, it connects without.",
        _nothing,
        "TLS-003",
        before=nameless_when_unreadable("modbus"),
    ),
    defect(
        "MU-98d",
        "modbus",
        "What the device refuses to the role is told as what it does not offer.",
        _refused_to_the_role("unsupported_operation", "the device does not offer this function"),
        "",
        "TLS-004",
    ),
    defect(
        "MU-98e",
        "modbus",
        "What the device refuses to the role is told as a fault of the protocol.",
        _refused_to_the_role("protocol_error", "the device sent an exception"),
        "",
        "TLS-004",
    ),
    defect(
        "MU-98f",
        "mqtt",
        "Where TLS cannot be agreed on, the broker is reached without.",
        in_clear_when_refused,
        "TLS-001 TLS-002",
        # Of a CONNECT that is refused for being in clear the broker knows no bdSeq.
        "SPB-006 TLS-001",
    ),
    defect("MU-98g", "mqtt", "The adapter's own certificate is read, and not presented.", nameless("MQTT"), "TLS-003"),
    defect(
        "MU-98h",
        "mqtt",
        "Where the adapter's own certificate cannot be read, it connects without.",
        _nothing,
        "TLS-003",
        before=nameless_when_unreadable("mqtt"),
    ),
    defect("MU-98k", "dnp3", "The adapter's own certificate is read, and not presented.", nameless("DNP3"), "TLS-003"),
    defect(
        "MU-98l",
        "ethernetip",
        "Where the adapter's own certificate cannot be read, it connects without.",
        _nothing,
        "TLS-003",
        before=nameless_when_unreadable("ethernetip"),
    ),
    defect("MU-98m", "opcua", "A certificate is presented that nobody has configured.", another_certificate, "TLS-003"),
    defect(
        "MU-98n",
        "opcua",
        "Where the adapter's own certificate cannot be read, it makes one.",
        _nothing,
        "TLS-003",
        before=another_certificate_when_unreadable,
    ),
    defect(
        "MU-98o",
        "opcua",
        "The security policy is always the same, whatever was configured.",
        _nothing,
        "TLS-003",
        before=one_policy,
    ),
    defect(
        "MU-98p", "opcua", "Messages are signed alone, although they were to be encrypted.", signed_alone, "TLS-003"
    ),
)
