"""One tool call while it runs: what it has sent so far, over which connection, and the envelope it ends in."""

from __future__ import annotations

import time
import uuid
from datetime import UTC, datetime
from typing import Any

from .errors import AdapterError

__all__ = ["Call"]


class Call:
    """Filled in by a tool while it works; becomes ``meta``.

    Attributes:
        attempts: requests that were handed to the transport, repetitions included.
        sent: a state-changing request may have left this process.
        trace: facts of the exchange as it was on the wire, see the envelope's description.
        source: ``device`` when the data came from the device in this call, else ``none``.
    """

    def __init__(self, *, protocol: str, operation: str, endpoint: str, writes: bool) -> None:
        self.protocol = protocol
        self.writes = writes
        self.attempts = 0
        self.sent = False
        self.trace: dict[str, Any] = {}
        self.source = "none"
        self._operation = operation
        self._endpoint = endpoint
        self._connection = {"state": "disconnected", "generation": 0}
        self._started_at = datetime.now(UTC)
        self._started = time.monotonic()

    def connection(self, *, generation: int, fresh: bool) -> None:
        """The call uses the connection of this generation; ``fresh`` when it had to be made for it."""
        state = "reconnected" if fresh and generation > 1 else "connected"
        self._connection = {"state": state, "generation": generation}

    def disconnected(self) -> None:
        """The connection was found broken."""
        self._connection["state"] = "disconnected"

    def sending(self) -> None:
        """A request is about to be handed to the transport."""
        self.attempts += 1
        self.sent = self.writes

    def answered(self, **trace: Any) -> None:
        """The device answered."""
        self.source = "device"
        self.trace.update(trace)

    def success(self, data: dict[str, Any]) -> dict[str, Any]:
        """The envelope of a call that did what was asked."""
        return {"success": True, "data": data, "error": None, "meta": self._meta()}

    def failure(self, error: AdapterError) -> dict[str, Any]:
        """The envelope of a call that did not."""
        data = None if error.partial is None else {"partial": error.partial}
        described = error.as_error(writes=self.writes, sent=self.sent)
        return {"success": False, "data": data, "error": described, "meta": self._meta()}

    def _meta(self) -> dict[str, Any]:
        started = self._started_at.isoformat(timespec="milliseconds").replace("+00:00", "Z")
        return {
            "schema": "otmcp/1.0",
            "protocol": self.protocol,
            "operation": self._operation,
            "endpoint": self._endpoint,
            "started_at": started,
            "latency_ms": round((time.monotonic() - self._started) * 1000, 3),
            "attempts": self.attempts,
            "request_id": uuid.uuid4().hex,
            "source": self.source,
            "connection": self._connection,
            "trace": self.trace,
        }
