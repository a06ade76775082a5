"""Finds what changed the plant without having been asked for, in any repetition of any task. Pure.

A call of an operation that writes accounts for one request that changes the plant, one of a named command with several effects for as
many, any other call for none. Whatever else the device saw of that kind is a finding: of the read that wrote, of the guard that leaked, of
the write that was sent again, be it in a later item.
To cancel a call is advice (MCP, Cancellation): a write that is carried out once although the kit has cancelled it is a warning.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

from ..core.finding import Finding
from ..protocols.exercise import THEN
from ..protocols.journal import Entries, JournalEntry
from ..protocols.protocol import Declared, OtProtocol
from ..subject.model import READ_ONLY
from .asked_for import Again, AskedFor
from .call_windows import LATE_NS, CallWindow
from .ledger import Judged

__all__ = ["delivered_before", "unasked_writes"]


def unasked_writes(
    windows: Sequence[CallWindow],
    entries: Entries,
    *,
    protocol: OtProtocol,
    declared: Declared,
    variant: str,
    asked_for: AskedFor,
    item: str,
) -> Iterator[tuple[Finding, Judged | None]]:
    """Find the requests that changed the plant and that no call accounts for, each with the call that made it, if it reads.

    Args:
        windows: the adapter's calls of one repetition.
        entries: journal of its device in this repetition.
        protocol, variant: of the adapter.
        declared: the lists of the protocol's own keys in the subject file.
        asked_for: what the adapter's calls have asked for until now; what these calls ask for is noted there.
        item: in which they are.
    """
    left = {id(call): _asked(call, protocol) for window in windows for call in window.calls}
    answers: defaultdict[int | None, list[JournalEntry]] = defaultdict(list)
    for entry in entries:
        answers[entry["answers"]].append(entry)
    begun = -1
    for entry in protocol.changes(entries):
        while begun + 1 < len(windows) and entry["t_ns"] >= _begin(windows[begun + 1]):
            begun += 1
        unsolicited = protocol.unsolicited([entry], declared)
        if not unsolicited:
            continue
        marked = asked_for.again(entry, protocol, item=item) if entry.get("dup") else None
        if marked is not None:
            yield _delivered(marked, entry, windows[: begun + 1], protocol), None
            continue
        owner = _accounting(windows[: begun + 1], left)
        # What comes before the next call may have been on its way when the call was cancelled.
        cancelled = None if owner is not None else _cancelled(windows[:begun], left)
        if owner is not None:
            left[id(owner)] = max(0, left[id(owner)] - max(1, protocol.parts(entry)))
            asked_for.add(entry, answers[entry["seq"]], label=owner.reply.label, item=item)
        elif cancelled is not None:
            left[id(cancelled)] -= 1
            yield _carried_out(cancelled, protocol.describe(entry)), None
        elif asked_for.arrives(entry, answers[entry["seq"]]):
            continue
        elif (
            begun >= 0
            and not _writing(windows[begun], protocol)
            and (again := asked_for.again(entry, protocol, item=item))
        ):
            yield _delivered(again, entry, windows[: begun + 1], protocol), None
        elif (found := _finding(windows[: begun + 1], entry, unsolicited[0], protocol, variant)) is not None:
            yield found
    asked_for.expect(
        (
            call.reply.label
            for window in windows
            for call in window.calls
            if call.reply.success
            for _ in range(left[id(call)])
        ),
        item=item,
    )


def _begin(window: CallWindow) -> int:
    return window.calls[0].reply.exchange.sent_ns


def _asked(call: Judged, protocol: OtProtocol) -> int:
    if not protocol.operations[call.reply.operation].writes:
        return 0
    return 0 if _nothing_sent(call) else _effects(call)


def _effects(call: Judged) -> int:
    """Return how many writes a call asks for: of several targets, each with its value, one for each."""
    then, items = call.inputs.get(THEN, ()), call.inputs.get("items", ())
    targets = len(items) if isinstance(items, list) else 0
    return max(1, targets) + len(then if isinstance(then, list) else ())


def _nothing_sent(call: Judged) -> bool:
    """The adapter says that the write has not left it."""
    error = (call.reply.envelope or {}).get("error")
    return isinstance(error, dict) and (error.get("outcome") == "not_sent" or error.get("code") == "writes_disabled")


def _accounting(windows: Sequence[CallWindow], left: dict[int, int]) -> Judged | None:
    """Return the call that a request now belongs to: one of the last ones, or an earlier success whose message comes late."""
    last = [call for call in windows[-1].calls if left[id(call)]] if windows else []
    late = [call for window in windows for call in window.calls if left[id(call)] and call.reply.success]
    return next(iter([*last, *late]), None)


def _cancelled(windows: Sequence[CallWindow], left: Mapping[int, int]) -> Judged | None:
    """Return an earlier call that the kit has cancelled, and whose request has not been seen yet."""
    return next((call for window in windows for call in window.calls if left[id(call)] and call.reply.cancelled), None)


def _carried_out(call: Judged, what: str) -> Finding:
    return Finding(
        code="cancelled_write",
        message=f"{call.reply.label}: the kit cancelled the call, and the device saw {what} after that",
        requirement="TMO-003",
        strength="SHOULD",
    )


def delivered_before(
    entries: Entries, protocol: OtProtocol, *, asked_for: AskedFor, item: str
) -> tuple[list[Finding], Entries]:
    """Return what was delivered again before an item, when nobody called the adapter, and the entries that no call accounts for."""
    marked = [
        (entry, again)
        for entry in protocol.changes(entries)
        if entry.get("dup") and (again := asked_for.again(entry, protocol, item=item)) is not None
    ]
    seen = [entry["seq"] for entry, _ in marked]
    seen += [
        entry["seq"]
        for entry in protocol.changes(entries)
        if entry["seq"] not in seen
        and asked_for.arrives(entry, [one for one in entries if one["answers"] == entry["seq"]])
    ]
    findings = [_delivered(again, entry, (), protocol) for entry, again in marked]
    return findings, [entry for entry in entries if entry["seq"] not in seen]


def _delivered(again: Again, entry: JournalEntry, windows: Sequence[CallWindow], protocol: OtProtocol) -> Finding:
    meanwhile = f"while {windows[-1].calls[0].reply.label} was called" if windows else "when nobody called the adapter"
    message = f"{again.label}, the device saw {protocol.describe(entry)} as well, {meanwhile} ({again.told})"
    return Finding(code="unasked_write", message=message, requirement="WR-003")


def _finding(
    windows: Sequence[CallWindow], entry: JournalEntry, unsolicited: Finding, protocol: OtProtocol, variant: str
) -> tuple[Finding, Judged | None] | None:
    """Say what is wrong with a request; None where it came during the proof of a session, of which nothing is expected.

    Args:
        windows: calls until then.
        unsolicited: what it is where nobody asked for anything.
    """
    what = protocol.describe(entry)
    window = windows[-1] if windows else None
    failed = [call for earlier in windows[:-1] for call in _writing(earlier, protocol) if not call.reply.success]
    if failed and window is not None and not _writing(window, protocol):
        late = _meant(failed, what)
        became, requirement = _became(late)
        message = f"{late.reply.label}: {became}, and the device saw {what} after that"
        return Finding(code="unasked_write", message=message, requirement=requirement), None
    if window is None or (entry["t_ns"] > window.end_ns + LATE_NS and not _writing(window, protocol)):
        message = f"while nobody called the adapter the device saw {what}, which changes the plant"
        return Finding(code="unasked_write", message=message, requirement=unsolicited.requirement), None
    writing = _writing(window, protocol)
    if not writing:
        call = window.calls[0]
        if call.proof:
            return None
        message = f"{call.reply.label}: it only reads, but the device saw {what}, which changes the plant"
        requirement = "WR-004" if variant == READ_ONLY else "MCP-008"
        return Finding(code="unasked_write", message=message, requirement=requirement), call
    call = writing[0]
    if _nothing_sent(call):
        message = f"{call.reply.label}: it says that nothing was sent, the device saw {what}"
        guarded = call.reply.error_code == "writes_disabled"
        return Finding(code="unasked_write", message=message, requirement="WR-004" if guarded else "ERR-006"), None
    count = _effects(call)
    message = f"{call.reply.label}: {'one write was' if count == 1 else f'{count} writes were'} asked for, the device saw {what} as well"
    return Finding(code="unasked_write", message=message, requirement="WR-003"), None


def _meant(failed: Sequence[Judged], what: str) -> Judged:
    """Return the call, of those that failed, that a late request is of: the last of those with most values that the request has."""
    words = re.findall(r"[\w.+-]+", what)
    return max(reversed(failed), key=lambda call: sum(str(value) in words for value in call.inputs.values()))


def _became(call: Judged) -> tuple[str, str]:
    """Return in words what became of a call that was no success, and the requirement that a write after it breaks."""
    if call.reply.cancelled:
        # Its one request was seen before this one.
        return "the kit cancelled the call, which had been carried out", "TMO-003"
    if not call.reply.answered:
        return "it was never answered", "TMO-001"
    return "it was reported as failed", "WR-010"


def _writing(window: CallWindow, protocol: OtProtocol) -> list[Judged]:
    return [call for call in window.calls if protocol.operations[call.reply.operation].writes]
