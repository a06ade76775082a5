"""One tool call while it runs: the requests that it has sent, the connection that it uses, and its envelope."""

from __future__ import annotations

import secrets
import time
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from .bounds import Bounds
from .errors import AdapterError

if TYPE_CHECKING:
    from .gates import Gate

__all__ = ["Call", "Connection"]


class Connection:
    """The last known state of the connection to the device; one per server, shared by its calls.

    Attributes:
        state: ``connected`` or ``disconnected``.
        generation: number of connections so far.
    """

    def __init__(self) -> None:
        self.state = "disconnected"
        self.generation = 0


class Call:
    """The facts of one call, reported by its tool while it works; they become ``meta``.

    A tool, or the link below it, reports in this order::

        call.changes(("1/holding_registers/5", 40))
        call.connection(generation=link.generation, fresh=just_connected)
        call.trace.update(unit=1, function=3)
        call.sending()  # immediately before the bytes go to the transport
        call.answered()  # when the device has answered, with success or refusal

    A tool that skips one of these reports makes the envelope wrong: ``attempts``, ``outcome`` and ``source`` have no other
    source.

    Attributes:
        attempts: requests that were handed to the transport, repetitions included.
        writes_sent: state-changing requests that may have left this process.
        trace: facts of the exchange as it was on the wire; see the envelope's description.
        source: ``device`` when the data came from the device in this call, ``cache`` when it was received earlier,
            else ``none``.
        gate: what decides on a write, where something does.
        extra: members of ``meta`` that only some calls have: ``age_ms``, ``truncated``, ``untrusted``, ….
    """

    def __init__(
        self,
        *,
        protocol: str,
        operation: str,
        endpoint: str,
        writes: bool,
        shared: Connection | None = None,
        bounds: Bounds | None = None,
        gate: Gate | None = None,
    ) -> None:
        self.protocol = protocol
        self.writes = writes
        self.attempts = 0
        self.writes_sent = 0
        self.trace: dict[str, Any] = {}
        self.source = "none"
        self.extra: dict[str, Any] = {}
        self._operation = operation
        self._endpoint = endpoint
        self._bounds = bounds
        self.gate = gate
        self._said: list[tuple[str, object]] | None = None
        self._request_id = secrets.token_hex(16)
        self._shared = Connection() if shared is None else shared
        self._used: dict[str, Any] | None = None
        self._started_at = datetime.now(UTC)
        self._started = time.monotonic()

    def connection(self, *, generation: int, fresh: bool) -> None:
        """Note the connection that the call uses; ``fresh`` when the connection was made for this call."""
        state = "reconnected" if fresh and generation > 1 else "connected"
        self._used = {"state": state, "generation": generation}
        self._shared.state = "connected"
        self._shared.generation = max(generation, self._shared.generation)

    def disconnected(self) -> None:
        """Note that the connection was found broken, or could not be made."""
        generation = self._shared.generation if self._used is None else self._used["generation"]
        self._used = {"state": "disconnected", "generation": generation}
        if generation == self._shared.generation:
            self._shared.state = "disconnected"

    def changes(self, *targets: tuple[str, object]) -> None:
        """Say what the call is about to change, before anything of it is sent.

        What a call says twice is decided once: a tool made of others says first all that these are going to say.

        Args:
            targets: name of each target, with the number that it gets in the device's own terms, or None where it is no number.

        Raises:
            AdapterError: a target may not be written, or its value is beyond a limit.
        """
        said = self._said or []
        new = [target for target in targets if target not in said]
        if self.gate is not None:
            try:
                self.gate.changes(new)
            except AdapterError as refusal:
                if not self.writes_sent:
                    raise
                message = f"a part was sent before this was refused: {refusal.message}"
                raise AdapterError("partial_failure", message, outcome="partial", details=refusal.details) from None
        if self._bounds is not None:
            self._bounds.check(new)
        self._said = said + new

    def begin(self) -> None:
        """Begin, or begin again, before anything was sent that changes the plant."""
        self._said = None
        if self.gate is not None:
            self.gate.begin()

    def sending(self, *, changes_state: bool = True) -> None:
        """Note that a request is about to be handed to the transport.

        Args:
            changes_state: False for a question of a writing tool, for instance for the type of its target.
        """
        if self.writes and changes_state:
            if self._bounds is not None and self._said is None:
                message = "this tool does not say what it changes, so it may not write while there are bounds"
                raise AdapterError("access_denied", message, outcome="not_sent")
            if self.gate is not None:
                self.gate.sending(self._request_id)
        self.attempts += 1
        self.writes_sent += self.writes and changes_state

    def answered(self, **trace: Any) -> None:
        """Note that the device answered."""
        self.source = "device"
        self.trace.update(trace)

    def success(self, data: dict[str, Any]) -> dict[str, Any]:
        """Return the envelope of a call that succeeded."""
        return {"success": True, "data": data, "error": None, "meta": self._closed(None)}

    def failure(self, error: AdapterError) -> dict[str, Any]:
        """Return the envelope of a call that failed."""
        data = None if error.partial is None else {"partial": error.partial}
        described = error.as_error(writes=self.writes, sent=self.writes_sent > 0)
        return {"success": False, "data": data, "error": described, "meta": self._closed(described)}

    def cancelled(self) -> None:
        """Note that nobody waits for the answer any more."""
        if self.gate is not None:
            outcome = "unknown" if self.writes_sent else "not_sent"
            self.gate.ended(self._request_id, {"code": "cancelled", "outcome": outcome})

    def _closed(self, error: dict[str, Any] | None) -> dict[str, Any]:
        """Close the call's record, where there is an audit log, and return the member ``meta``."""
        if self.gate is not None:
            self.gate.ended(self._request_id, error)
            self.extra |= self.gate.meta
        return self._meta()

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
            "request_id": self._request_id,
            "source": self.source,
            # A call that ended before it used the connection reports the state that other calls found.
            "connection": self._used or {"state": self._shared.state, "generation": self._shared.generation},
            "trace": self.trace,
            **self.extra,
        }
