"""Who calls: on stdio whom the environment of the process names, on HTTP whom a token names.

Environment: ``OT_PRINCIPAL`` (the user of the process) and ``OT_ROLE`` (``viewer``, ``operator`` or ``engineer``; viewer). Whoever starts the
process decides. On HTTP the two are not looked at, and these say whose tokens are taken: ``MCP_AUTH_ISSUER``, ``MCP_AUTH_KEYS`` (a JSON file,
the issuer's key set, RFC 7517) and ``MCP_AUTH_RESOURCE`` (this server's own URL, the audience that a token must have). The scope ``ot:read`` lets a
caller in; ``ot:operate`` makes it an operator, ``ot:engineer`` an engineer.

Nothing that a caller says in its arguments, and nothing that a device says, can make a role.
"""

from __future__ import annotations

import getpass
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .settings import ConfigError, Environment

if TYPE_CHECKING:
    from mcp.server.auth.provider import AccessToken
    from mcp.server.auth.settings import AuthSettings

__all__ = ["Principal", "Tokens", "of_environment", "of_token"]

_ROLES = ("viewer", "operator", "engineer")
_READ, _SCOPES = "ot:read", {"ot:engineer": "engineer", "ot:operate": "operator"}
# Of a key that both sides hold (HS256) each side can make tokens; "none" needs no key.
_ALGORITHMS = ["ES256", "ES384", "RS256", "PS256", "EdDSA"]


@dataclass(frozen=True, slots=True)
class Principal:
    """A caller.

    Attributes:
        name: where it is known from, and as whom: ``local:alice``, ``https://issuer/#alice``.
        role: ``viewer``, ``operator`` or ``engineer``.
    """

    name: str
    role: str


def of_environment(environment: Environment) -> Principal:
    """Return the caller on stdio.

    Raises:
        ConfigError: there is no such role.
    """
    role = environment.text("OT_ROLE", "viewer")
    if role not in _ROLES:
        raise ConfigError(f"OT_ROLE: expected {', '.join(_ROLES)}, found {role!r}")
    return Principal(f"local:{environment.optional('OT_PRINCIPAL') or getpass.getuser()}", role)


def of_token() -> Principal:
    """Return the caller whose token the present request has."""
    from mcp.server.auth.middleware.auth_context import get_access_token

    token = get_access_token()
    # The server answers 401 before any tool is called without one.
    assert token is not None
    role = next((role for scope, role in _SCOPES.items() if scope in token.scopes), "viewer")
    return Principal(f"{(token.claims or {}).get('iss')}#{token.subject}", role)


class Tokens:
    """A verifier of the tokens of one issuer for one server (RFC 9068: JSON Web Tokens).

    Attributes:
        settings: what the SDK's resource server needs to know.
    """

    def __init__(self, issuer: str, keys: Path, resource: str) -> None:
        import jwt
        from mcp.server.auth.settings import AuthSettings

        self._issuer = issuer
        self._resource = resource
        try:
            self._keys = jwt.PyJWKSet.from_json(keys.read_text())
        except OSError as error:
            raise ConfigError(f"MCP_AUTH_KEYS: {keys} cannot be read: {error.strerror}") from None
        except (ValueError, jwt.PyJWTError) as error:
            raise ConfigError(f"MCP_AUTH_KEYS: {keys}: {error}") from None
        try:
            self.settings: AuthSettings = AuthSettings.model_validate(
                {
                    "issuer_url": issuer,
                    "resource_server_url": resource,
                    "required_scopes": [_READ],
                    "validate_token_resource": True,
                }
            )
        except ValueError:
            raise ConfigError("MCP_AUTH_ISSUER and MCP_AUTH_RESOURCE: expected URLs") from None

    @classmethod
    def of(cls, environment: Environment) -> Tokens | None:
        """Return the verifier that the environment describes; None where no issuer is named.

        Raises:
            ConfigError: the key set cannot be used, or the server's own URL is missing.
        """
        issuer = environment.optional("MCP_AUTH_ISSUER")
        if issuer is None:
            return None
        return cls(issuer, Path(environment.text("MCP_AUTH_KEYS")), environment.text("MCP_AUTH_RESOURCE"))

    async def verify_token(self, token: str) -> AccessToken | None:
        """Return what a token says, or None where it is not to be believed."""
        import jwt
        from mcp.server.auth.provider import AccessToken

        try:
            key = self._keys[jwt.get_unverified_header(token)["kid"]]
            claims = jwt.decode(
                token,
                key,
                algorithms=_ALGORITHMS,
                issuer=self._issuer,
                audience=self._resource,
                options={"require": ["exp", "iat", "aud", "iss", "sub"]},
            )
        except (jwt.PyJWTError, KeyError):
            return None
        return AccessToken(
            token=token,
            client_id=str(claims.get("client_id", claims["sub"])),
            scopes=str(claims.get("scope", "")).split(),
            expires_at=int(claims["exp"]),
            resource=self._resource,
            subject=str(claims["sub"]),
            claims=claims,
        )
