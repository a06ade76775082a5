"""Judges what an envelope's ``meta`` says of a call by what the device saw of it. Pure.

Every call of an adapter with envelopes of its own is judged, whatever its role. Where the device cannot have seen everything,
because it was down, the network lost bytes or a connection died, nothing is concluded from what it did not see.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from urllib.parse import urlsplit

from ..core.finding import Finding
from ..core.strict_json import same_json
from ..protocols.journal import HANDSHAKES, UNTOLD, Entries, JournalEntry
from ..protocols.protocol import Declared, OtProtocol
from .call_windows import LATE_NS, CallWindow, from_adapter
from .ledger import Judged

__all__ = ["Address", "meta_faults"]

Address = tuple[str, int]
"""Host and port."""

_CLOCK_TICK_MS = 16.6
"""A clock that ticks every 15.6 ms, and the rounding of what it shows."""

_LOCAL = frozenset({"localhost", "127.0.0.1", "::1"})


def meta_faults(
    window: CallWindow, call: Judged, *, protocol: OtProtocol, declared: Declared, addresses: Collection[Address]
) -> Iterator[Finding]:
    """Judge one call.

    Args:
        window: that the call is in.
        protocol: of the adapter.
        declared: the lists of the protocol's own keys in the subject file.
        addresses: of the device.
    """
    meta = (call.reply.envelope or {}).get("meta")
    if not call.reply.native or not isinstance(meta, dict):
        return
    yield from _endpoint(call, meta, addresses)
    writes = protocol.operations[call.reply.operation].writes
    # Nobody answers some messages: they may arrive after the reply.
    seen = window.until_end if writes else window.until_next
    attempts = meta.get("attempts")
    if isinstance(attempts, bool) or not isinstance(attempts, int):
        return
    if meta.get("source") == "device" and not any(_is_traffic(entry) for entry in (*window.standing, *seen)):
        # What else it says of an exchange that there was not has the same cause.
        yield _without_traffic(call)
        return
    kinds = {entry["kind"] for entry in seen}
    if call.reachable and not kinds & {"CONNECTED", "lost", "tls_plaintext"}:
        yield from _attempts(window, call, attempts, seen, protocol, declared)
    # Of what the device could not read it cannot say what was in it.
    if attempts and call.reachable and not kinds & {"malformed", "lost", "tls_plaintext"}:
        # Requests that went to a connection that had ended, before a new one was made, were not read either; what opens a session is none.
        renewed = "CONNECTED" in kinds
        if not renewed or (call.reply.success and attempts <= sum(entry["request"] for entry in from_adapter(seen))):
            yield from _trace(call, meta.get("trace"), [*window.standing, *seen], protocol)
        yield from _latency(window, call, meta.get("latency_ms"), attempts)


def _endpoint(call: Judged, meta: Mapping[str, object], addresses: Collection[Address]) -> Iterator[Finding]:
    stated = meta.get("endpoint")
    address = _address(stated) if isinstance(stated, str) else None
    if address is None or not addresses:
        return
    if address not in {(_canonical(host), port) for host, port in addresses}:
        host, port = next(iter(addresses))
        yield Finding(
            code="other_endpoint",
            message=f"{call.reply.label}: meta.endpoint should be that of the device, {host}:{port}, it is {stated!r}",
            requirement="ENV-006",
        )


def _address(endpoint: str) -> Address | None:
    try:
        parts = urlsplit(endpoint)
        return None if parts.hostname is None or parts.port is None else (_canonical(parts.hostname), parts.port)
    except ValueError:
        return None


def _canonical(host: str) -> str:
    return "localhost" if host in _LOCAL else host


def _without_traffic(call: Judged) -> Finding:
    return Finding(
        code="source_without_traffic",
        message=f"{call.reply.label}: meta.source is 'device', the device saw nothing of the adapter during the call",
        requirement="ENV-008",
    )


def _is_traffic(entry: JournalEntry) -> bool:
    return entry["origin"] == "client" and entry["kind"] not in ("CONNECTED", "DISCONNECTED", *HANDSHAKES)


def _attempts(
    window: CallWindow, call: Judged, attempts: int, seen: Entries, protocol: OtProtocol, declared: Declared
) -> Iterator[Finding]:
    sent = from_adapter(seen)
    if attempts > len(sent):
        sent += window.standing
    if attempts > len(sent):
        sent += _late(window, known={entry["seq"] for entry in seen})
    if attempts > len(sent) and call.reply.error_code not in _MAYBE_UNREAD:
        yield Finding(
            code="attempts",
            message=f"{call.reply.label}: meta.attempts says {attempts}, the device saw {len(sent)} request(s) during the call",
            requirement="ENV-005",
            evidence=protocol.seen(sent) or None,
        )
        return
    changes = [entry for entry in protocol.changes(window.during) if protocol.unsolicited([entry], declared)]
    if len(window.calls) == 1 and protocol.operations[call.reply.operation].writes and attempts < len(changes):
        yield Finding(
            code="attempts",
            message=f"{call.reply.label}: meta.attempts says {attempts}, the device saw {len(changes)} request(s) that write",
            requirement="ENV-005",
            evidence=protocol.seen(changes),
        )


_MAYBE_UNREAD = frozenset({"connect_failed", "connection_lost", "timeout", "protocol_error", "tls_error"})
"""Failures of a connection: the device may have ended it before it read the request that the trace is about, and may have seen
others of the same call, such as subscriptions that were made anew."""


def _trace(call: Judged, trace: object, seen: Entries, protocol: OtProtocol) -> Iterator[Finding]:
    if not isinstance(trace, Mapping) or protocol.facts is None or call.reply.error_code in _MAYBE_UNREAD:
        return
    known = _facts(seen, protocol.facts)
    for name, wire in known.items():
        if UNTOLD in wire:
            continue
        stated = _member(trace, name.split("."))
        for value in stated if isinstance(stated, list) else [stated]:
            if value is not None and not any(same_json(value, fact) for fact in wire):
                shown = " and ".join(dict.fromkeys(map(repr, wire)))
                yield Finding(
                    code="trace_differs",
                    message=f"{call.reply.label}: meta.trace says {name} {value!r}, on the wire it was {shown[:200]}",
                    requirement="ENV-007",
                    evidence=protocol.seen(from_adapter(seen)) or None,
                )
                return


def _facts(
    entries: Entries, facts: Callable[[JournalEntry], Mapping[str, Sequence[object]]]
) -> dict[str, list[object]]:
    known: dict[str, list[object]] = {}
    for entry in entries:
        if entry["origin"] == "client":
            for name, values in facts(entry).items():
                known.setdefault(name, []).extend(values)
    return known


def _member(trace: Mapping[str, object], path: Sequence[str]) -> object:
    found: object = trace
    for name in path:
        found = found.get(name) if isinstance(found, Mapping) else None
    return found


def _late(window: CallWindow, known: Collection[int]) -> list[JournalEntry]:
    """Return messages soon after the last reply that may be of these calls, without those whose ``seq`` is known.

    What is answered is a request of a later call, and so are as many messages during a later call as that one says it sent.
    """
    until = window.end_ns + LATE_NS
    answered = {entry["answers"] for entry in window.until_end}
    late = [
        entry
        for entry in from_adapter(window.until_end)
        if entry["t_ns"] <= until and entry["seq"] not in known and entry["seq"] not in answered
    ]
    later = window.following
    while late and later is not None and later.begin_ns <= until:
        during = {entry["seq"] for entry in from_adapter(later.during)}
        spare = max(0, len(during) - sum(map(_stated_attempts, later.calls)))
        unclaimed = [entry for entry in late if entry["seq"] in during][:spare]
        late = [entry for entry in late if entry["seq"] not in during] + unclaimed
        later = later.following
    return late


def _stated_attempts(call: Judged) -> int:
    meta = (call.reply.envelope or {}).get("meta")
    attempts = meta.get("attempts") if isinstance(meta, dict) else None
    return attempts if isinstance(attempts, int) else 0


def _latency(window: CallWindow, call: Judged, stated: object, attempts: int) -> Iterator[Finding]:
    if isinstance(stated, bool) or not isinstance(stated, int | float) or len(window.calls) != 1:
        return
    asked = {entry["seq"]: entry["t_ns"] for entry in from_adapter(window.during)}
    spans = [(entry["t_ns"] - asked[entry["answers"]]) / 1e6 for entry in window.during if entry["answers"] in asked]
    # Of an adapter that also asks by itself nobody knows which request the call waited for.
    if len(asked) != attempts or not spans or stated >= max(spans) - _CLOCK_TICK_MS:
        return
    yield Finding(
        code="latency_below_device",
        message=f"{call.reply.label}: meta.latency_ms says {stated} ms, the device alone took {max(spans):.3f} ms",
        requirement="ENV-004",
    )
