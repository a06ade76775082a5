"""Matching of a session's frames to the calls that caused them; frames without a call are kept."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mcp.types import (
    JSONRPCError,
    JSONRPCMessage,
    JSONRPCRequest,
    JSONRPCResponse,
    jsonrpc_message_adapter,
)
from pydantic import ValidationError

from .canary import SecretSearch, place_of
from .limits import Allowance, is_too_large

__all__ = ["MAX_STRAY_LINES", "META_KEY", "FrameRecorder", "Measurement"]

META_KEY = "pytest-otmcp/exchange"
"""Key that ties a frame to the call that caused it, also when several calls run at once. ``_meta`` is the place that
the specification gives for such keys (basic, "General fields"), and servers must ignore unknown keys."""

MAX_STRAY_LINES = 1000
_KEPT_STRAY_LINES = 5
_LIST_CHANGED = "notifications/tools/list_changed"
_LONGEST_ID = 100
_LONGEST_STRAY = 1000


@dataclass(slots=True)
class Measurement:
    """The frames of one call as far as they have passed; see :class:`~pytest_otmcp.session.exchange.Exchange`."""

    request: bytes = b""
    response: bytes | None = None
    sent_ns: int = 0
    received_ns: int | None = None
    refusal: str | None = None


@dataclass(slots=True)
class FrameRecorder:
    """A recorder that matches frames to the calls that caused them.

    Attributes:
        stray_count, stray: lines that are no MCP message: how many, and the first few.
        unknown_ids: ids of responses to requests that were never sent.
        repeated_ids: ids of requests that were answered more than once (JSON-RPC 2.0, section 5: one response for each).
        too_deep: number of messages that are nested deeper than the client's parser reads.
        overflow: True when a message arrived that is larger than the kit accepts, or one more than it keeps.
        allowance: the room for answers to calls.
        listing: the room for the pages of one list of tools.
        secrets: are looked for in every frame.
        list_changes: how often the adapter has announced that its tools have changed.
    """

    stray_count: int = 0
    stray: list[bytes] = field(default_factory=list)
    unknown_ids: list[str] = field(default_factory=list)
    repeated_ids: list[str] = field(default_factory=list)
    too_deep: int = 0
    overflow: bool = False
    allowance: Allowance = field(default_factory=Allowance)
    listing: Allowance = field(default_factory=Allowance)
    secrets: SecretSearch = field(default_factory=SecretSearch)
    list_changes: int = 0
    _answered: set[object] = field(default_factory=set)
    _pending: dict[int, Measurement] = field(default_factory=dict)
    _by_request_id: dict[object, Measurement] = field(default_factory=dict)
    _known_ids: set[object] = field(default_factory=set)
    _tokens: itertools.count[int] = field(default_factory=lambda: itertools.count(1))

    def begin(self, measurement: Measurement) -> int:
        """Expect the frames of a call; return the token for its request's ``_meta`` under :data:`META_KEY`."""
        token = next(self._tokens)
        self._pending[token] = measurement
        return token

    def end(self, token: int) -> None:
        """Stop expecting the frames of a call."""
        self._pending.pop(token, None)

    def sent(self, now: int, frame: bytes, identifier: Any, params: Mapping[str, Any] | None) -> None:
        """Note that a request is about to be written."""
        self._known_ids.add(identifier)
        token = ((params or {}).get("_meta") or {}).get(META_KEY)
        measurement = self._pending.get(token) if isinstance(token, int) else None
        if measurement is not None:
            self._by_request_id[identifier] = measurement
            measurement.request = frame
            measurement.sent_ns = now

    def refused(self, now: int, identifier: Any, failure: str) -> None:
        """Note that a request was refused by HTTP status before anybody has read it, so that there is no frame in answer."""
        measurement = self._by_request_id.pop(identifier, None)
        if measurement is not None:
            measurement.received_ns = now
            measurement.refusal = failure

    def accepts(self, frame: bytes) -> bool:
        """Tell whether a frame is to be read, before a parser sees it; one that is too large is an overflow."""
        if is_too_large(frame):
            self.overflow = True
            self.secrets.look(frame, lambda: "a message that is too long")
        return not self.overflow

    def received(self, now: int, frame: bytes, *, of_error: bool = False) -> JSONRPCMessage | ValidationError | None:
        """Note that a frame was read; return its message, the error when it holds no message, or None for a notification:
        the kit uses none.

        Args:
            of_error: it is the body of an HTTP answer whose status is that of an error.
        """
        self.secrets.look(frame, lambda: self._place(frame))
        try:
            message = jsonrpc_message_adapter.validate_json(frame)
        except ValidationError as error:
            # Its traceback leads to the caller, which keeps the error: a circle, which holds the frame until the collector comes.
            error.__traceback__ = None
            first = error.errors(include_url=False, include_context=False, include_input=False)[0]
            if first["type"] == "json_invalid" and "recursion limit" in first["msg"]:
                self.too_deep += 1
                return error
            self.stray_count += 1
            if len(self.stray) < _KEPT_STRAY_LINES:
                self.stray.append(frame[:_LONGEST_STRAY])
            return error
        if isinstance(message, JSONRPCResponse | JSONRPCError):
            measurement = self._by_request_id.pop(message.id, None)
            if not (self.listing if measurement is None else self.allowance).has_room_for(frame):
                self.overflow = True
            elif measurement is not None:
                measurement.response = frame
                measurement.received_ns = now
            if message.id is None:
                # JSON-RPC 2.0, section 5: the error of a request whose id could not be read.
                pass
            elif message.id not in self._known_ids:
                # With an HTTP error the body answers the HTTP request, and should have no id (MCP 2025-11-25, Transports, 2.4): version 1 of the
                # official SDK puts "server-error" there, for a request without a session.
                if not (of_error and isinstance(message, JSONRPCError)):
                    _keep(self.unknown_ids, message.id)
            elif message.id in self._answered:
                _keep(self.repeated_ids, message.id)
            else:
                self._answered.add(message.id)
        elif not isinstance(message, JSONRPCRequest):
            self.list_changes += message.method == _LIST_CHANGED
            return None
        return message

    def _place(self, frame: bytes) -> str:
        try:
            message = json.loads(frame)
        except (ValueError, RecursionError):
            message = None
        asked = self._by_request_id.get(message.get("id")) if isinstance(message, dict) else None
        return place_of(message, b"" if asked is None else asked.request)


def _keep(identifiers: list[str], identifier: object) -> None:
    if len(identifiers) < _KEPT_STRAY_LINES:
        identifiers.append(repr(identifier)[:_LONGEST_ID])
