"""The secure channel: policy, mode and certificates from settings, and the check of the server's certificate.

``OPCUA_CA`` names the certificates that are believed, of issuers or of servers themselves, ``OPCUA_CERT`` and ``OPCUA_KEY`` the adapter's own, all as
PEM; ``OPCUA_SECURITY_POLICY`` is one of three (Basic256Sha256), ``OPCUA_SECURITY_MODE`` is SignAndEncrypt or Sign. asyncua trusts every
server, and with its own validator still takes any host and any key; so everything is checked here (OPC 10000-4, 6.1.3), before the session is
activated and a password leaves.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from asyncua import Client, ua
from asyncua.crypto.security_policies import (
    SecurityPolicyAes128Sha256RsaOaep,
    SecurityPolicyAes256Sha256RsaPss,
    SecurityPolicyBasic256Sha256,
)
from asyncua.crypto.uacrypto import CertProperties
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID

from ..core import AdapterError, ConfigError, Environment

__all__ = ["Security"]

_POLICIES = {
    "Basic256Sha256": SecurityPolicyBasic256Sha256,
    "Aes128_Sha256_RsaOaep": SecurityPolicyAes128Sha256RsaOaep,
    "Aes256_Sha256_RsaPss": SecurityPolicyAes256Sha256RsaPss,
}
"""Those that are not deprecated (OPC 10000-7)."""
_MODES = {"SignAndEncrypt": ua.MessageSecurityMode.SignAndEncrypt, "Sign": ua.MessageSecurityMode.Sign}
_SMALLEST_KEY = 2048
_WEAK = (hashes.MD5, hashes.SHA1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Security:
    """How the channel is secured.

    Attributes:
        host: of the server, as its URL names it.
        policy, mode: the security policy, as asyncua has it, and the message security mode.
        certificate, key: the adapter's own, as PEM.
        application: the adapter's URI, which its certificate has.
        believed: certificates of issuers, or of servers.
    """

    host: str
    policy: Any
    mode: ua.MessageSecurityMode
    certificate: bytes
    key: bytes
    application: str
    believed: Sequence[x509.Certificate]

    @classmethod
    def of(cls, environment: Environment, host: str) -> Security | None:
        """Return what the settings say; None when there are none.

        Raises:
            ConfigError: a setting is missing, or cannot be used.
        """
        names = ("OPCUA_CA", "OPCUA_CERT", "OPCUA_KEY", "OPCUA_SECURITY_POLICY", "OPCUA_SECURITY_MODE")
        if not any(map(environment.optional, names)):
            return None
        believed, own = _certificates(environment, "OPCUA_CA"), _certificates(environment, "OPCUA_CERT")[0]
        policy = _choice(environment, "OPCUA_SECURITY_POLICY", _POLICIES)
        mode = _choice(environment, "OPCUA_SECURITY_MODE", _MODES)
        if environment.optional("OPCUA_PASSWORD") and mode != ua.MessageSecurityMode.SignAndEncrypt:
            raise ConfigError("OPCUA_SECURITY_MODE: expected SignAndEncrypt, because there is a password")
        try:
            uris = _names(own).get_values_for_type(x509.UniformResourceIdentifier)
        except x509.ExtensionNotFound:
            uris = []
        if not uris or not _is_valid_now(own):
            raise ConfigError("OPCUA_CERT: expected a certificate that is valid now and has an application URI")
        return cls(
            host=host,
            policy=policy,
            mode=mode,
            certificate=_read(environment, "OPCUA_CERT"),
            key=_read(environment, "OPCUA_KEY"),
            application=uris[0],
            believed=believed,
        )

    async def prepare(self, client: Client) -> None:
        """Let a client that is not connected yet use the channel. The server is asked for its endpoints over a connection of its own.

        Raises:
            AdapterError: the server has no endpoint with this policy and mode.
        """
        client.application_uri = self.application
        client.certificate_validator = self._check
        try:
            await client.set_security(
                self.policy,
                CertProperties(self.certificate, extension="pem"),
                CertProperties(self.key, extension="pem"),
                mode=self.mode,
            )
        except ua.UaError as error:
            if isinstance(error, ua.UaStatusCodeError):
                raise
            raise _refused("it has no endpoint with this policy and mode") from None

    async def _check(self, certificate: x509.Certificate, server: ua.ApplicationDescription) -> None:
        try:
            faults = list(self._faults(certificate, server.ApplicationUri))
        except x509.ExtensionNotFound:
            faults = ["its certificate says nothing of its names or its use"]
        if faults:
            raise _refused(faults[0])

    def _faults(self, certificate: x509.Certificate, application: str) -> Iterator[str]:
        """Say what is wrong with a server's certificate; the order is that of OPC 10000-4, table 100."""
        if certificate not in self.believed and not any(_has_issued(one, certificate) for one in self.believed):
            yield "the issuer of its certificate is unknown"
        if not _is_valid_now(certificate):
            yield "its certificate has expired, or is not valid yet"
        names = _names(certificate)
        if self.host not in _hosts(names):
            yield "its certificate is for another host"
        if application not in names.get_values_for_type(x509.UniformResourceIdentifier):
            yield "its certificate is for another application"
        usage = certificate.extensions.get_extension_for_class(x509.KeyUsage).value
        extended = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        if not (usage.digital_signature and usage.key_encipherment) or ExtendedKeyUsageOID.SERVER_AUTH not in extended:
            yield "its certificate is not for a server"
        key = certificate.public_key()
        if not isinstance(key, rsa.RSAPublicKey) or key.key_size < _SMALLEST_KEY:
            yield "its key is too short"
        if isinstance(certificate.signature_hash_algorithm, _WEAK):
            yield "the hash of its certificate is too weak"


def _refused(reason: str) -> AdapterError:
    message = f"no secure channel to the server: {reason}"
    return AdapterError("tls_error", message, outcome="not_sent", details={"reason": reason})


def _has_issued(issuer: x509.Certificate, certificate: x509.Certificate) -> bool:
    try:
        is_authority = issuer.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
        certificate.verify_directly_issued_by(issuer)
    except (x509.ExtensionNotFound, InvalidSignature, ValueError, TypeError):
        return False
    return is_authority and _is_valid_now(issuer)


def _is_valid_now(certificate: x509.Certificate) -> bool:
    now = datetime.datetime.now(datetime.UTC)
    return certificate.not_valid_before_utc <= now <= certificate.not_valid_after_utc


def _names(certificate: x509.Certificate) -> x509.SubjectAlternativeName:
    return certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value


def _hosts(names: x509.SubjectAlternativeName) -> set[str]:
    return {*names.get_values_for_type(x509.DNSName), *map(str, names.get_values_for_type(x509.IPAddress))}


def _choice(environment: Environment, name: str, known: dict[str, Any]) -> Any:
    text = environment.text(name, next(iter(known)))
    if text not in known:
        raise ConfigError(f"{name}: expected one of {', '.join(known)}, found {text!r}")
    return known[text]


def _read(environment: Environment, name: str) -> bytes:
    path = environment.text(name)
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ConfigError(f"{name}: {path} cannot be read: {error.strerror}") from None


def _certificates(environment: Environment, name: str) -> list[x509.Certificate]:
    try:
        return x509.load_pem_x509_certificates(_read(environment, name))
    except ValueError:
        raise ConfigError(f"{name}: expected certificates in PEM") from None
