"""Who calls an adapter over HTTP: the kit as the issuer of tokens (RFC 9068, JSON Web Tokens), good ones and bad ones.

A token is made for each request, so that it is as old as its check wants it.
"""

from __future__ import annotations

import json
import time
from typing import Any, Literal

from ..protocols.bounds import Scopes

__all__ = ["FOREIGN_ORIGIN", "ISSUER", "Caller", "Guise"]

Guise = Literal[
    "writer",
    "reader",
    "nobody",
    "garbage",
    "unsigned",
    "other_key",
    "other_issuer",
    "other_audience",
    "no_audience",
    "expired",
    "web_page",
]
"""Whom the next requests come from: one who may write, or read alone; without a token; with a token that is none, that has no signature, or one
of an unknown key, of another issuer, for another server, for none, that is over; one who may write, from a web page of another origin."""

ISSUER = "https://issuer.otmcp.invalid/"
FOREIGN_ORIGIN = "https://page.otmcp.invalid"
_ELSEWHERE = "https://elsewhere.otmcp.invalid/"
_KEY_ID, _ALGORITHM = "otmcp", "ES256"
_GOOD_S = 600


class Caller:
    """The callers of one adapter, and the issuer whose tokens they bring.

    Args:
        scopes: of who may write, and of who may read alone.

    Attributes:
        guise: of the requests that follow.
    """

    def __init__(self, scopes: Scopes) -> None:
        self.guise: Guise = "writer"
        self._audience = ""
        self._scopes = scopes
        # They take time to import, and few runs have callers.
        from cryptography.hazmat.primitives.asymmetric import ec

        self._key, self._unknown_key = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))

    def begin(self, audience: str) -> None:
        """Be one who may write, for a new session with the adapter at this URL."""
        self.guise, self._audience = "writer", audience

    @property
    def key_set(self) -> bytes:
        """The issuer's public key, as JSON (RFC 7517)."""
        import jwt

        public: dict[str, Any] = jwt.algorithms.ECAlgorithm.to_jwk(self._key.public_key(), as_dict=True)
        return json.dumps({"keys": [{**public, "kid": _KEY_ID, "alg": _ALGORITHM, "use": "sig"}]}).encode()

    def headers(self) -> dict[str, str]:
        """Return the headers of a request that is sent now."""
        if self.guise == "nobody":
            return {}
        told = {"Authorization": f"Bearer {self._token()}"}
        return {**told, "Origin": FOREIGN_ORIGIN} if self.guise == "web_page" else told

    def _token(self) -> str:
        import jwt

        now = int(time.time())
        claims: dict[str, Any] = {
            "iss": ISSUER,
            "aud": self._audience,
            "sub": "otmcp",
            "client_id": "otmcp",
            "jti": f"otmcp-{time.monotonic_ns()}",
            "iat": now,
            "nbf": now,
            "exp": now + _GOOD_S,
            "scope": (self._scopes.reads if self.guise == "reader" else None) or self._scopes.writes,
        }
        match self.guise:
            case "garbage":
                return "otmcp"
            case "unsigned":
                return jwt.encode(claims, "", algorithm="none", headers={"kid": _KEY_ID})
            case "other_issuer":
                claims["iss"] = _ELSEWHERE
            case "other_audience":
                claims["aud"] = _ELSEWHERE
            case "no_audience":
                del claims["aud"]
            case "expired":
                claims |= dict.fromkeys(("iat", "nbf"), now - 2 * _GOOD_S) | {"exp": now - _GOOD_S}
        key = self._unknown_key if self.guise == "other_key" else self._key
        return jwt.encode(claims, key, algorithm=_ALGORITHM, headers={"kid": _KEY_ID})
