"""The certificates of one run: a small authority of the kit's own, the devices' good and bad ones, and those of the adapters.

The bad ones are those that every client must refuse (requirement TLS-002). Keys are of P-256; OPC UA needs RSA.
"""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ..core.credentials import CLIENT, ROLE

__all__ = ["Authority", "make"]

_ROLE_EXTENSION = x509.ObjectIdentifier("1.3.6.1.4.1.50316.802.1")
_HERE = ("localhost", "127.0.0.1")
_FOR_BOTH = (ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH)
_DAY = datetime.timedelta(days=1)

Key = ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey


def make(folder: Path, application: str = "") -> Mapping[str, bytes]:
    """Write the certificates of devices into a folder, as :mod:`mocks.tls` reads them; return those of adapters.

    Args:
        application: URI of the device's application, for OPC UA; its certificates have it, and keys of RSA.

    Returns:
        ``ca``, ``cert`` and ``key``, each as PEM.
    """
    # It takes long to make one of RSA.
    key = _rsa(2048) if application else ec.generate_private_key(ec.SECP256R1())
    good, other = Authority("otmcp-ca", key), Authority("otmcp-other-ca")
    own: dict[str, Any] = {"key": key, "uris": (application,) if application else ()}
    devices = {
        "server": good.issue("otmcp-device", **own),
        "server2": good.issue("otmcp-device-2", **own),
        "unknown_issuer": other.issue("otmcp-device", **own),
        "self_signed": Authority("otmcp-device", key).itself(),
        "expired": good.issue("otmcp-device", days=(-10, -1), **own),
        "not_yet_valid": good.issue("otmcp-device", days=(2, 10), **own),
        "other_host": good.issue("otmcp-device", hosts=("plant.example", "192.0.2.1"), **own),
        "client_only": good.issue("otmcp-device", usage=(ExtendedKeyUsageOID.CLIENT_AUTH,), **own),
        "weak_key": good.issue("otmcp-device", **{**own, "key": _rsa(1024)}),
    }
    if application:
        devices["other_application"] = good.issue("otmcp-device", key=key, uris=(f"{application}:other",))
    for name, parts in devices.items():
        (folder / f"{name}.pem").write_bytes(b"".join(parts))
    (folder / "ca.pem").write_bytes(good.pem)
    more: dict[str, Any] = {"key": _rsa(2048), "uris": (f"urn:{CLIENT}",)} if application else {"role": ROLE}
    certificate, private = good.issue(CLIENT, **more)
    return {"ca": good.pem, "cert": certificate, "key": private}


def _rsa(bits: int) -> rsa.RSAPrivateKey:
    return rsa.generate_private_key(65537, bits)


class Authority:
    """An issuer of certificates; without a key it has one of P-256."""

    def __init__(self, name: str, key: Key | None = None) -> None:
        self._name = _named(name)
        self._key = key or ec.generate_private_key(ec.SECP256R1())
        usage = {"key_cert_sign": True, "crl_sign": True}
        self._certificate = self._signed(
            self._name,
            self._key,
            (-1, 2),
            (x509.BasicConstraints(ca=True, path_length=0), True),
            (_usage(**usage), True),
            (_alternative(_HERE), False),
        )
        self.pem = _pem(self._certificate)

    def itself(self) -> tuple[bytes, bytes]:
        """Return the issuer's own certificate and key."""
        return self.pem, _pem_of_key(self._key)

    def issue(
        self,
        name: str,
        *,
        hosts: Sequence[str] = _HERE,
        uris: Sequence[str] = (),
        days: tuple[int, int] = (-1, 2),
        usage: Sequence[x509.ObjectIdentifier] = _FOR_BOTH,
        role: str | None = None,
        key: Key | None = None,
    ) -> tuple[bytes, bytes]:
        """Return a certificate and its key.

        Args:
            name: common name.
            hosts, uris: names, addresses and applications that it is for.
            days: from when to when it is valid, from today.
            usage: extended key usage.
            role: of MODBUS/TCP Security, at most 127 characters of ASCII.
            key: of its holder; without one a new key of P-256.
        """
        key = key or ec.generate_private_key(ec.SECP256R1())
        extensions: list[tuple[Any, bool]] = [
            (x509.BasicConstraints(ca=False, path_length=None), True),
            (
                _usage(digital_signature=True, content_commitment=True, key_encipherment=True, data_encipherment=True),
                True,
            ),
            (x509.ExtendedKeyUsage(list(usage)), False),
            (_alternative(hosts, uris), False),
        ]
        if role is not None:
            # A UTF8String of DER: its tag, its length in one byte, its characters.
            text = role.encode("ascii")
            extensions.append((x509.UnrecognizedExtension(_ROLE_EXTENSION, bytes([0x0C, len(text)]) + text), False))
        return _pem(self._signed(_named(name), key, days, *extensions)), _pem_of_key(key)

    def _signed(
        self, name: x509.Name, key: Key, days: tuple[int, int], *extensions: tuple[Any, bool]
    ) -> x509.Certificate:
        now = datetime.datetime.now(datetime.UTC)
        builder = (
            x509.CertificateBuilder()
            .subject_name(name)
            .issuer_name(self._name)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now + days[0] * _DAY)
            .not_valid_after(now + days[1] * _DAY)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False)
        )
        for extension, critical in extensions:
            builder = builder.add_extension(extension, critical=critical)
        return builder.sign(self._key, hashes.SHA256())


def _named(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _alternative(hosts: Sequence[str], uris: Sequence[str] = ()) -> x509.SubjectAlternativeName:
    return x509.SubjectAlternativeName([*map(_host, hosts), *map(x509.UniformResourceIdentifier, uris)])


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _usage(**given: bool) -> x509.KeyUsage:
    every = dict.fromkeys(
        ("digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement"), False
    )
    every |= dict.fromkeys(("key_cert_sign", "crl_sign", "encipher_only", "decipher_only"), False)
    return x509.KeyUsage(**{**every, **given})


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _pem_of_key(key: Key) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
