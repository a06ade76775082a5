"""A person's approval of a write: asked for over MCP where the client can ask, else in an inbox outside of MCP.

An approval is for one caller, tool, arguments, targets with their values, endpoint and policy; it is used once, and ends after a time. Both eras of MCP
have a way to ask. Until 2025-11-25 the server sends ``elicitation/create`` during the call. Since 2026-07-28 the call ends with what is asked, and the
client repeats it with the answer and ``requestState``. That is a random number here, and what it stands for stays in this process: nothing of it can be
changed by the client, a restart voids it, and its refusal is an envelope (the SDK's ``RequestStateBoundary`` would answer -32602 before any code of ours).

What a client answers proves that the client said yes, not that a person did. Stronger is the *inbox*: a folder in which a request lies as a file until
somebody answers by ``python -m pytest_otmcp.reference_adapters.approvals``. The call is refused with ``approval_required``, and the same call again
goes through once it was approved. Whoever may write into the folder can approve: it must not be the assistant.

Environment: ``OT_APPROVAL_INBOX`` (the folder), ``OT_APPROVAL_S`` (seconds until an approval ends; 120).
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import pwd
import secrets
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from mcp import MCPError
from mcp.server import ServerRequestContext
from mcp.types.version import MODERN_PROTOCOL_VERSIONS

from .errors import AdapterError
from .settings import ConfigError, Environment

__all__ = ["Approvals", "InputRequired", "Request"]

_KEY = "approval"
_FORM: dict[str, Any] = {
    "type": "object",
    "properties": {"approve": {"type": "boolean", "title": "Let this be written"}},
    "required": ["approve"],
}
_MOST_OPEN = 100


class InputRequired(Exception):
    """The call ends here, and the client is to repeat it with an answer.

    Attributes:
        result: the call's result on the wire.
    """

    def __init__(self, result: dict[str, Any]) -> None:
        super().__init__()
        self.result = result


@dataclass(frozen=True, slots=True)
class Request:
    """What a person is asked.

    Attributes:
        text: makes the text for the person, for which the device may have to be asked.
        bound: everything that the approval is for.
    """

    text: Callable[[], Awaitable[str]]
    bound: Mapping[str, Any]

    @property
    def digest(self) -> str:
        """What two requests have in common that are for the same."""
        return hashlib.sha256(json.dumps(self.bound, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class _Open:
    digest: str
    until: float
    number: str
    shown: bytes = b""


class Approvals:
    """The approvals that are waited for, in this process only."""

    def __init__(self, inbox: Path | None, valid_s: float) -> None:
        self.inbox = inbox
        self.valid_s = valid_s
        self._open: dict[str | tuple[str], _Open] = {}
        """By ``requestState``. Others by a tuple, which no client can send: those in the inbox by the digest of their request."""

    @classmethod
    def of(cls, environment: Environment) -> Approvals:
        """Return what the environment says of approvals.

        Raises:
            ConfigError: the inbox is no folder.
        """
        name = environment.optional("OT_APPROVAL_INBOX")
        inbox = None if name is None else Path(name)
        if inbox is not None and not inbox.is_dir():
            raise ConfigError(f"OT_APPROVAL_INBOX: {inbox} is no folder")
        return cls(inbox, environment.seconds("OT_APPROVAL_S", 120.0))

    async def obtain(self, context: ServerRequestContext[Any, Any], request: Request, *, outside: bool) -> str:
        """Return who has approved a request: ``client``, or ``inbox:`` and the owner of the answer.

        Args:
            outside: the client is not enough.

        Raises:
            AdapterError: ``approval_required``, ``approval_denied`` or ``approval_expired``.
            InputRequired: the client has to be asked first.
        """
        asked = context.session.client_capabilities
        # A client that names neither mode means forms.
        elicits = asked is not None and (mode := asked.elicitation) is not None and not (mode.url and not mode.form)
        if elicits and not outside:
            if context.protocol_version in MODERN_PROTOCOL_VERSIONS:
                await self._answered(context.params or {}, request)
            else:
                await self._elicit(context, request)
            return "client"
        if self.inbox is None:
            raise _refusal("required", "a person has to approve this, and this client cannot ask; nothing was written")
        return await self._looked_up(self.inbox, request)

    async def _elicit(self, context: ServerRequestContext[Any, Any], request: Request) -> None:
        text, key = await request.text(), (secrets.token_hex(8),)
        self._keep(key, _Open(request.digest, time.monotonic() + self.valid_s, ""))
        try:
            async with asyncio.timeout(self.valid_s):
                answer = await context.session.elicit_form(text, _FORM, related_request_id=context.request_id)
        except TimeoutError:
            raise _refusal("expired", f"nobody has answered within {self.valid_s:g} s; nothing was written") from None
        except (MCPError, ValueError):
            raise _refusal("denied", "the client's answer is no approval; nothing was written") from None
        finally:
            self._open.pop(key, None)
        _judge(answer.action, answer.content)

    async def _answered(self, params: Mapping[str, Any], request: Request) -> None:
        state = params.get("requestState")
        if state is None:
            text, state = await request.text(), secrets.token_urlsafe(24)
            self._keep(state, _Open(request.digest, time.monotonic() + self.valid_s, state))
            form = {"mode": "form", "message": text, "requestedSchema": _FORM}
            asked = {_KEY: {"method": "elicitation/create", "params": form}}
            raise InputRequired({"resultType": "input_required", "inputRequests": asked, "requestState": state})
        # Taken before anything else: of two that come with it, one has it.
        given = self._open.pop(state, None) if isinstance(state, str) else None
        if given is None or given.digest != request.digest:
            raise _refusal("denied", "this is no open approval of this call; nothing was written")
        if time.monotonic() > given.until:
            raise _refusal("expired", "the approval came too late; nothing was written")
        answers = params.get("inputResponses")
        answer = answers.get(_KEY) if isinstance(answers, dict) else None
        answer = answer if isinstance(answer, dict) else {}
        _judge(answer.get("action"), answer.get("content"))

    def _keep(self, key: str | tuple[str], one: _Open) -> None:
        now = time.monotonic()
        # For as long again a late answer is told that it is late.
        for known, entry in list(self._open.items()):
            if now > entry.until + self.valid_s:
                del self._open[known]
                self._clear(entry)
        if len(self._open) >= _MOST_OPEN:
            message = f"{_MOST_OPEN} approvals are being waited for"
            raise AdapterError("rate_limited", message, outcome="not_sent", retry_after_ms=round(1000 * self.valid_s))
        self._open[key] = one

    async def _looked_up(self, inbox: Path, request: Request) -> str:
        key = (request.digest,)
        if key not in self._open:
            shown = self._shown(request, await request.text())
            found = _Open(request.digest, time.monotonic() + self.valid_s, secrets.token_hex(8), shown)
            if key in self._open:
                # The same call at the same time was faster.
                raise self._waiting(self._open[key])
            self._keep(key, found)
            try:
                _written(inbox / f"{found.number}.request", found.shown)
            except OSError as error:
                del self._open[key]
                raise _refusal("required", f"the inbox for approvals cannot be written: {error.strerror}") from None
            raise self._waiting(found)
        found = self._open[key]
        answer = inbox / f"{found.number}.answer"
        late = time.monotonic() > found.until
        if not late and not answer.exists():
            raise self._waiting(found)
        del self._open[key]
        try:
            said, owner = (b"", 0) if late else (answer.read_bytes(), answer.stat().st_uid)
        except OSError:
            said, owner = b"", 0
        self._clear(found)
        if late:
            raise _refusal("expired", "nobody has approved this in time; nothing was written")
        # What was approved is what was shown: the answer names it by its bytes.
        if said.split() != [b"approve", hashlib.sha256(found.shown).hexdigest().encode()]:
            raise _refusal("denied", "this was not approved; nothing was written")
        return f"inbox:{_user(owner)}"

    def _clear(self, one: _Open) -> None:
        if self.inbox is not None and one.shown:
            for end in ("request", "answer"):
                (self.inbox / f"{one.number}.{end}").unlink(missing_ok=True)

    def _waiting(self, one: _Open) -> AdapterError:
        rest = max(0, round(1000 * (one.until - time.monotonic())))
        details = {"approval_id": one.number, "expires_in_ms": rest}
        message = "a person has to approve this outside of this conversation; make the same call again afterwards"
        return _refusal("required", message, details)

    def _shown(self, request: Request, text: str) -> bytes:
        until = (datetime.now(UTC) + timedelta(seconds=self.valid_s)).isoformat(timespec="seconds")
        return json.dumps({"text": text, "until": until, **request.bound}, indent=1).encode()


def _judge(action: object, content: object) -> None:
    # "yes" and 1 are no approvals: what is asked for is true.
    if action != "accept" or not isinstance(content, dict) or content.get("approve") is not True:
        raise _refusal("denied", "this was not approved; nothing was written")


def _refusal(what: str, message: str, details: dict[str, Any] | None = None) -> AdapterError:
    return AdapterError(f"approval_{what}", message, outcome="not_sent", details=details)


def _written(path: Path, data: bytes) -> None:
    """Let a file appear with all that it holds, where there is none.

    Raises:
        OSError: there is one, or it cannot be written.
    """
    new = path.with_name(f"{path.name}.{secrets.token_hex(4)}")
    try:
        with open(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(data)
        os.link(new, path)
    finally:
        new.unlink(missing_ok=True)


def _user(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)


def answered(inbox: Path, number: str, *, approve: bool) -> str:
    """Answer the request with this number, as a person does, and return its text.

    Raises:
        OSError: there is no such request, or it has been answered.
    """
    request = inbox / f"{number}.request"
    shown = request.read_bytes()
    text: str = json.loads(shown)["text"]
    digest = hashlib.sha256(shown).hexdigest()
    _written(inbox / f"{number}.answer", f"{'approve' if approve else 'deny'} {digest}\n".encode())
    return text
