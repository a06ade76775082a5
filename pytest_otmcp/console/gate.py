"""The gate before the console: it lets requests of the console's own page in, and no others.

Whatever runs in the browser may send requests to a port of this machine, and so may every program of every user on it. A request of the
page has the exact host and origin of the console, and below ``/api/`` the token, which only the printed address holds: in its
fragment, which a browser neither sends nor logs. There is no cookie, because every port of 127.0.0.1 would receive it.

This file knows ASGI and no framework.
"""

from __future__ import annotations

import hmac
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

__all__ = ["Application", "Gate"]

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Message, Receive, Send], Awaitable[None]]

_POLICY = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
_HEADERS = {
    b"content-security-policy": _POLICY.encode(),
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"no-referrer",
    b"cross-origin-opener-policy": b"same-origin",
    b"cross-origin-resource-policy": b"same-origin",
    b"cache-control": b"no-store",
}


class Gate:
    """An ASGI application before another one.

    Args:
        application: the console.
        origin: of the console's page, such as ``http://127.0.0.1:40001``.
        token: the secret of this process.
    """

    def __init__(self, application: Application, origin: str, token: str) -> None:
        self._application = application
        self._origin = origin.encode()
        self._host = origin.partition("//")[2].encode()
        self._bearer = f"Bearer {token}".encode()

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it by its status alone."""
        refused = self._refused(scope)

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                own = {name for name, _ in message["headers"]}
                message["headers"] = [
                    *message["headers"],
                    *((name, value) for name, value in _HEADERS.items() if name not in own),
                ]
            await send(message)

        if refused is None:
            await self._application(scope, receive, guarded)
            return
        await guarded({"type": "http.response.start", "status": refused, "headers": [(b"content-length", b"0")]})
        await guarded({"type": "http.response.body", "body": b""})

    def _refused(self, scope: Message) -> int | None:
        """Return the status by which a request is refused; None for one that is let in."""
        headers: list[tuple[bytes, bytes]] = scope["headers"]
        if [value for name, value in headers if name == b"host"] != [self._host]:
            # A name that an attacker's server has made to lead here is none of this console's.
            return 421
        if any(value != self._origin for name, value in headers if name == b"origin"):
            return 403
        if any(value not in (b"same-origin", b"none") for name, value in headers if name == b"sec-fetch-site"):
            return 403
        if not scope["path"].startswith("/api/"):
            return None
        given = b"".join(value for name, value in headers if name == b"authorization")
        if not hmac.compare_digest(given, self._bearer):
            return 401
        kinds = [value for name, value in headers if name == b"content-type"]
        if scope["method"] == "POST" and kinds != [b"application/json"]:
            return 415
        return None
