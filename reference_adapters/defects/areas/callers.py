"""Defects of a server over HTTP that knows its callers by tokens, which the check of MCP-011 notices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ...core import AdapterServer, principal
from ..defect import Change, defect

__all__ = ["DEFECTS"]


def _believing(**options: object) -> Change:
    """Return the defect that less of a token is verified.

    Args:
        options: of ``jwt.decode``, instead of the adapter's.
    """

    def apply(server: AdapterServer) -> None:
        import jwt

        genuine, verify = jwt.decode, principal.Tokens.verify_token

        def decode(token: str, key: Any, *, options: Any, **known: Any) -> Any:
            told: Any = {**options, **changed}
            return genuine(token, key, options=told, **known)

        async def verify_token(self: Any, token: str) -> Any:
            found = await verify(self, token)
            # The SDK's server looks at the time itself, where it is told one.
            return found and found.model_copy(update={"expires_at": None})

        changed: Any = options
        jwt.decode = decode
        principal.Tokens.verify_token = verify_token

    return apply


def _served(change: Callable[[dict[str, Any]], None]) -> Change:
    """Return the defect that the HTTP application is made with other arguments."""

    def apply(server: AdapterServer) -> None:
        genuine = server.mcp.streamable_http_app

        def app(**told: Any) -> Any:
            change(told)
            return genuine(**told)

        server.mcp.streamable_http_app = app

    return apply


def _any_origin(told: dict[str, Any]) -> None:
    told["transport_security"] = told["transport_security"].model_copy(
        update={"enable_dns_rebinding_protection": False}
    )


def _every_role(server: AdapterServer) -> None:
    genuine = principal.of_token
    principal.of_token = lambda: replace(genuine(), role="engineer")


def _asks_nobody(server: AdapterServer) -> None:
    """Name the settings of tokens, and no verifier: the SDK's server is open then."""

    def forget(told: dict[str, Any]) -> None:
        told["token_verifier"] = None

    _served(forget)(server)
    principal.of_token = lambda: principal.Principal("local:anybody", "operator")


DEFECTS = (
    defect("MU-114", "modbus", "Over HTTP web pages of any origin may call.", _served(_any_origin), "MCP-011"),
    defect("MU-114n", "s7", "There are settings of tokens, and nothing that verifies any.", _asks_nobody, "MCP-011"),
    defect(
        "MU-114a",
        "modbus",
        "Tokens for another server are taken, and those for none.",
        _believing(verify_aud=False, require=["exp"]),
        "MCP-011",
    ),
    defect("MU-114e", "mqtt", "A token that is over is taken.", _believing(verify_exp=False), "MCP-011"),
    defect("MU-114i", "opcua", "Tokens of any issuer are taken.", _believing(verify_iss=False), "MCP-011"),
    defect(
        "MU-114s",
        "modbus",
        "Every token is taken, whoever has signed it.",
        _believing(verify_signature=False),
        "MCP-011",
    ),
    defect("MU-114r", "dnp3", "What the scopes of a token allow makes no difference.", _every_role, "MCP-011"),
)
