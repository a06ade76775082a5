"""An exchange: one request of the kit to a subject and what came back, as measured. Pure; knows no MCP library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

__all__ = ["CANCELLED", "REFUSALS", "TOO_LONG", "Answer", "Exchange", "joined", "joint"]

_AND = "+"

CANCELLED = "cancelled"
"""Failure of an exchange that the kit itself has cancelled."""

TOO_LONG = "frame_too_long"
"""Failure of an exchange that the kit has ended, with its session, because a message was longer than it reads."""

REFUSALS: Mapping[int, str] = {401: "unauthorized", 403: "forbidden", 413: "content_too_large"}
"""HTTP statuses by which a subject refuses a request that it has not read (RFC 9110, sections 15.5.2, .4 and .14), each to the failure of such an
exchange."""


Answer = Literal["accept", "decline", "cancel", "no", "text", "none", "silence"]
"""Accept; decline; cancel; accept with a form that says no, or with a text in the place of a truth value; no answer, which ends the question; no
answer at all, for which the adapter may wait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exchange:
    """One request of the kit: what was sent, what came back, and when.

    Attributes:
        tool: name of the tool, or URI of the resource; for joined exchanges, all their names with ``+`` in between.
        arguments: of the call.
        request: the request frame as written, without its newline.
        response: the response frame as read, or None when none came.
        sent_ns: monotonic time just before the request was written.
        received_ns: monotonic time at which the response, or the refusal by HTTP status, had been read, or None.
        starved_ns: time for which the machine kept the subject, or the kit, waiting for a processor meanwhile; 0 for less than
            :data:`~.starvation.LOOK_S`.
        failure: why there is no usable response (``timeout``, ``connection_closed``, ``cancelled``, ``frame_too_long``, or one of :data:`REFUSALS`), or
            None.
        client_complaint: what the official SDK client objected to in the response, or None.
        asked_ns, returned_ns: monotonic times at which the SDK client was asked, and at which it had processed the
            response; 0 where the time of the client was not measured.
    """

    tool: str
    arguments: Mapping[str, object]
    request: bytes = b""
    response: bytes | None = None
    sent_ns: int = 0
    received_ns: int | None = None
    starved_ns: int = 0
    failure: str | None = None
    client_complaint: str | None = None
    asked_ns: int = 0
    returned_ns: int = 0

    @property
    def latency_ms(self) -> float | None:
        """Time from the request's writing to the response's reading, in milliseconds; None without one."""
        return None if self.received_ns is None else (self.received_ns - self.sent_ns) / 1e6


def joined(exchanges: Sequence[Exchange], arguments: Mapping[str, object]) -> Exchange:
    """Join the exchanges of one operation into one, from the first request to the last reply.

    Args:
        arguments: those of the operation.
    """
    first, last = exchanges[0], exchanges[-1]
    return replace(
        last,
        tool=_AND.join(exchange.tool for exchange in exchanges),
        arguments=dict(arguments),
        request=b"\n".join(exchange.request for exchange in exchanges),
        sent_ns=first.sent_ns,
        starved_ns=sum(exchange.starved_ns for exchange in exchanges),
        asked_ns=first.asked_ns,
    )


def joint(tool: str) -> int:
    """Return how many exchanges were joined into the one of this tool."""
    return tool.count(_AND) + 1
