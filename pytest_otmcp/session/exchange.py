"""What a session's transport saw: exchanges matched to their frames, and everything that belongs to none. Pure bookkeeping."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mcp.types import (
    JSONRPCError,
    JSONRPCMessage,
    JSONRPCNotification,
    JSONRPCRequest,
    JSONRPCResponse,
    jsonrpc_message_adapter,
)
from pydantic import ValidationError

__all__ = ["META_KEY", "Exchange", "FrameRecorder"]

META_KEY = "pytest-otmcp/exchange"
"""Ties a frame to the call that caused it, also when several run at once. ``_meta`` is the place the specification gives
for such keys (basic, "General fields"), and servers must ignore unknown ones."""

MAX_STRAY_LINES = 1000
_KEPT_STRAY_LINES = 5


@dataclass(slots=True, kw_only=True)
class Exchange:
    """One request of the kit's: what was sent, what came back, and when.

    Attributes:
        tool: name of the tool, or URI of the resource.
        request: the request frame as written, without its newline.
        response: the response frame as read, or None when none came.
        sent_ns: monotonic time just before the request was written.
        received_ns: monotonic time at which the response had been read, or None.
        failure: why there is no usable response (``timeout``, ``connection_closed``), or None.
        client_complaint: what the official SDK client objected to in the response, or None.
        asked_ns, returned_ns: monotonic; the SDK client was asked, and was done with the response.
    """

    tool: str
    arguments: dict[str, Any]
    request: bytes = b""
    response: bytes | None = None
    sent_ns: int = 0
    received_ns: int | None = None
    failure: str | None = None
    client_complaint: str | None = None
    asked_ns: int = 0
    returned_ns: int = 0

    @property
    def latency_ms(self) -> float | None:
        """From request written to response line read, in milliseconds."""
        if self.received_ns is None or not self.sent_ns:
            return None
        return (self.received_ns - self.sent_ns) / 1e6


@dataclass(slots=True)
class FrameRecorder:
    """Matches frames to exchanges.

    Attributes:
        stray_count, stray: lines that are no MCP message: how many, and the first few.
        unknown_ids: ids of responses to requests that were never sent.
        overflow: a message longer than the kit accepts arrived.
    """

    stray_count: int = 0
    stray: list[bytes] = field(default_factory=list)
    unknown_ids: list[str] = field(default_factory=list)
    overflow: bool = False
    _pending: dict[int, Exchange] = field(default_factory=dict)
    _by_request_id: dict[Any, Exchange] = field(default_factory=dict)
    _known_ids: set[Any] = field(default_factory=set)
    _tokens: itertools.count[int] = field(default_factory=lambda: itertools.count(1))

    def begin(self, exchange: Exchange) -> int:
        """Expect the frames of an exchange; the token goes into its request's ``_meta`` under :data:`META_KEY`."""
        token = next(self._tokens)
        self._pending[token] = exchange
        return token

    def end(self, token: int) -> None:
        """Nobody waits for the exchange any more."""
        self._pending.pop(token, None)

    def sent(self, now: int, frame: bytes, identifier: Any, params: Mapping[str, Any] | None) -> None:
        """A request is about to be written."""
        self._known_ids.add(identifier)
        token = ((params or {}).get("_meta") or {}).get(META_KEY)
        exchange = self._pending.get(token) if isinstance(token, int) else None
        if exchange is not None:
            self._by_request_id[identifier] = exchange
            exchange.request = frame
            exchange.sent_ns = now

    def received(self, now: int, frame: bytes) -> JSONRPCMessage | ValidationError | None:
        """A frame was read: the message it holds, what is wrong with it, or None for what a client has no use for."""
        try:
            message = jsonrpc_message_adapter.validate_json(frame)
        except ValidationError as error:
            self.stray_count += 1
            if len(self.stray) < _KEPT_STRAY_LINES:
                self.stray.append(frame)
            return error
        if isinstance(message, JSONRPCResponse | JSONRPCError):
            exchange = self._by_request_id.pop(message.id, None)
            if exchange is not None:
                exchange.response = frame
                exchange.received_ns = now
            elif message.id not in self._known_ids and len(self.unknown_ids) < _KEPT_STRAY_LINES:
                self.unknown_ids.append(repr(message.id))
        elif not isinstance(message, JSONRPCRequest | JSONRPCNotification):
            return None
        return message
