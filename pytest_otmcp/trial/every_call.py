"""Judges what holds for every call of every task, whatever its steps look at. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from ..core.finding import Finding
from ..protocols.journal import judged
from ..protocols.registry import protocols
from ..subject.model import READ_WRITE
from .call_windows import windows
from .connections import connections_left
from .ledger import Judged, Ledger
from .meta_claims import meta_faults
from .repetition import Repetition
from .rig import Rig
from .start_times import StartTimes
from .tool_listing import listing_faults
from .unasked_writes import unasked_writes

__all__ = ["EveryCall"]

_WRITES_SEEN = frozenset(
    {"not_written_once", "wrote", "written_twice", "not_published_once", "unexpected_packet", "made_up_for"}
)
"""Findings of a task's own oracles about requests that change the plant."""

_CONSEQUENCES = _WRITES_SEEN | {"device_differs"}

_NOT_ASKED = "no_exchange"
"""Finding of a task's own oracles: the device was not asked."""

_OF_NO_EXCHANGE = frozenset({"source_without_traffic", "attempts", "trace_differs"})
"""Findings about the same: what an envelope says of an exchange that there was not."""


class EveryCall:
    """Judges the calls of one item: each repetition when it is over, and what only the whole item shows at its end.

    Args:
        began_at: RFC 3339; when the item began.
        began_ns: monotonic; the same moment.
    """

    def __init__(self, began_at: str, began_ns: int) -> None:
        self._start_times = StartTimes(began_at, began_ns)
        self._listings: set[tuple[object, ...]] = set()
        self._of_item: list[Finding] = []

    def judge(self, repetition: Repetition) -> None:
        """Judge a repetition whose journals are complete; findings go to its ledger."""
        for at in repetition.all:
            _judge_by_journal(at, repetition.ledger)
            for stamp in protocols()[at.protocol].stamps(judged(repetition.ledger.of(at.protocol, at.variant))):
                self._start_times.compare(at.name, stamp)
        for call in _asked_for(repetition.ledger):
            self._start_times.look(call)
            owner = repetition.rig(call.reply.adapter)
            # The read-only variant need not list every tool, and lists no other ones.
            if owner is not None and call.reply.variant == READ_WRITE and call.altered is None:
                self._of_item += self._listing_faults(owner, call)

    def _listing_faults(self, at: Rig, call: Judged) -> Iterator[Finding]:
        tool = call.reply.tool
        operation = protocols()[at.protocol].operations[call.reply.operation]
        asked = (at.protocol, tool, operation.writes, operation.adds, *sorted(call.reply.arguments))
        listing = at.listing(call.reply.operation, tool)
        if listing is not None and asked not in self._listings:
            self._listings.add(asked)
            yield from listing_faults(
                tool, listing, arguments=call.reply.arguments, writes=operation.writes, adds=operation.adds
            )

    def at_end(self, ended_at: str, ended_ns: int) -> list[Finding]:
        """Return what the item as a whole has shown; see :class:`StartTimes` for the arguments."""
        return [*self._of_item, *self._start_times.faults(ended_at, ended_ns)]


def _asked_for(ledger: Ledger) -> list[Judged]:
    # Nothing is expected of the calls that prove a session.
    return [call for call in ledger.calls if not call.proof]


def _judge_by_journal(at: Rig, ledger: Ledger) -> None:
    """Judge an adapter's calls of a repetition that is over by the journal of its device.

    What a task's own oracles have found is not reported again. Only when a call that reads has written, that is the cause of what
    they found.
    """
    protocol = protocols()[at.protocol]
    calls = [call for call in ledger.calls if (call.reply.adapter, call.reply.variant) == (at.protocol, at.variant)]
    entries = judged(ledger.of(at.protocol, at.variant))
    made = windows(calls, entries)
    known = {finding.code for finding in ledger.findings}
    for window in made:
        for call in window.calls:
            if call.proof:
                continue
            for finding in meta_faults(
                window, call, protocol=protocol, declared=at.subject.declared, addresses=at.device.addresses
            ):
                if not (_NOT_ASKED in known and finding.code in _OF_NO_EXCHANGE):
                    ledger.reject(call.reply, finding)
    faults = at.session_faults()
    if at.variant == READ_WRITE or not known & _WRITES_SEEN:
        # A guard that leaks has no session that could keep further rules.
        ledger.witnessed(faults)
    ledger.witnessed(connections_left(entries))
    known = {finding.code for finding in ledger.findings}
    unasked = unasked_writes(
        made,
        entries,
        protocol=protocol,
        declared=at.subject.declared,
        variant=at.variant,
        asked_for=at.asked_for,
        item=ledger.item,
    )
    for finding, reader in unasked:
        if reader is not None and finding.requirement == "MCP-008":
            ledger.caused_by(reader.reply.tool, _CONSEQUENCES)
            ledger.reject(reader.reply, finding)
        elif not known & _WRITES_SEEN:
            ledger.witnessed([finding])
