"""Secure channels: what the server presents, who its client is, and messages as they would be without a seal.

A folder of certificates is as for :mod:`..tls`, and so are the names: ``nothing`` is a server that offers no security, ``old`` one that offers a deprecated
policy alone.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from asyncua import ua
from asyncua.common.connection import MessageChunk
from asyncua.crypto.security_policies import SecurityPolicyNone
from asyncua.ua.ua_binary import struct_to_binary
from cryptography import x509
from cryptography.hazmat.primitives.serialization import load_pem_private_key

__all__ = ["USUAL", "policies", "presented", "told_of", "unsealed"]

_NOTHING, USUAL, _OLD = "nothing", "server", "old"
_POLICIES = {
    _NOTHING: [ua.SecurityPolicyType.NoSecurity],
    _OLD: [ua.SecurityPolicyType.Basic128Rsa15_SignAndEncrypt, ua.SecurityPolicyType.Basic128Rsa15_Sign],
}
_EVERY = [
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Basic256Sha256_Sign,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_Sign,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_Sign,
]


def policies(name: str) -> list[ua.SecurityPolicyType]:
    """Return the policies of the endpoints with this certificate."""
    return _POLICIES.get(name, _EVERY)


def presented(folder: Path, name: str) -> tuple[x509.Certificate, Any]:
    """Return a certificate and its key.

    Raises:
        ValueError: there is none of this name.
    """
    file = folder / f"{USUAL if name in _POLICIES else name}.pem"
    if not file.is_file():
        raise ValueError(f"tls: there is no certificate {name!r}")
    content = file.read_bytes()
    return x509.load_pem_x509_certificate(content), load_pem_private_key(content, None)


def told_of(policy: Any) -> dict[str, Any] | None:
    """Return what the journal has of a channel with this policy; None of one without security."""
    if policy.Mode == ua.MessageSecurityMode.None_:
        return None
    certificate = x509.load_der_x509_certificate(policy.peer_certificate)
    return {
        "version": policy.URI.rpartition("#")[2],
        "cipher": policy.Mode.name,
        "subject": certificate.subject.rfc4514_string(),
        "role": None,
    }


def unsealed(chunk: MessageChunk) -> bytes:
    """Return a chunk that was received as it would be without signature and encryption."""
    header, security = chunk.MessageHeader, chunk.SecurityHeader
    if header.MessageType == ua.MessageType.SecureOpen:
        security = ua.AsymmetricAlgorithmHeader()
        security.SecurityPolicyURI = SecurityPolicyNone.URI
    content = struct_to_binary(security) + struct_to_binary(chunk.SequenceHeader) + chunk.Body
    kind = header.MessageType + header.ChunkType
    return bytes(kind + struct.pack("<II", 12 + len(content), header.ChannelId) + content)
