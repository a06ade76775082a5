"""TLS to the device: the settings, and what a failed handshake becomes.

Three settings are files in PEM: ``NAME_TLS_CA``, the issuers whose certificates are believed, ``NAME_TLS_CERT`` and ``NAME_TLS_KEY``, the adapter's
own certificate and its key. Nothing turns the verification off, and nothing but TLS is tried where TLS was asked for.
"""

from __future__ import annotations

import ssl

from .errors import AdapterError
from .settings import ConfigError, Environment

__all__ = ["client_context", "handshake_failure"]


def client_context(environment: Environment, prefix: str, *, always: bool = False) -> ssl.SSLContext | None:
    """Return the context for connections to the device; None when none of the settings is there.

    Args:
        prefix: of the settings' names, such as ``MODBUS``.
        always: TLS is asked for elsewhere; without ``NAME_TLS_CA`` the issuers are those that the system believes.

    Raises:
        ConfigError: a file cannot be used, or one of certificate and key is missing.
    """
    authority, certificate, key = (environment.optional(f"{prefix}_TLS_{name}") for name in ("CA", "CERT", "KEY"))
    if not (always or authority or certificate or key):
        return None
    if not (always or authority):
        raise ConfigError(f"{prefix}_TLS_CA is not set; it names the issuers of the device's certificate")
    if bool(certificate) != bool(key):
        raise ConfigError(f"{prefix}_TLS_CERT and {prefix}_TLS_KEY: expected both, or neither")
    try:
        context = ssl.create_default_context(cafile=authority)
    except OSError as error:
        raise _unusable(f"{prefix}_TLS_CA", authority, error) from None
    # Python's defaults are these; a system's own configuration of OpenSSL may be weaker.
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_ciphers("DEFAULT:@SECLEVEL=2")
    if certificate:
        try:
            # An encrypted key must not wait for a person at a terminal.
            context.load_cert_chain(certificate, key, password="")
        except (OSError, ValueError) as error:
            raise _unusable(f"{prefix}_TLS_CERT, {prefix}_TLS_KEY", f"{certificate}, {key}", error) from None
    return context


def _unusable(names: str, paths: str | None, error: Exception) -> ConfigError:
    reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or "it is encrypted"
    return ConfigError(f"{names}: {paths} cannot be used: {reason}")


def handshake_failure(error: BaseException, peer: str) -> AdapterError | None:
    """Return the error that a failure to connect over TLS is; None for one before the handshake, such as a refused connection.

    Args:
        peer: what messages call the device.
    """
    if isinstance(error, ssl.SSLCertVerificationError):
        return _error(f"the certificate of the {peer} is not accepted", error.verify_message)
    if isinstance(error, ssl.SSLError):
        return _error(f"no secure connection to the {peer}", error.reason)
    if isinstance(error, ConnectionRefusedError) or not isinstance(error, ConnectionError):
        return None
    return _error(f"no secure connection to the {peer}", "the connection ended in the handshake")


def _error(what: str, reason: str | None) -> AdapterError:
    told = reason or "unknown"
    return AdapterError("tls_error", f"{what}: {told}", outcome="not_sent", details={"reason": told})
