"""AUD: the audit log of an adapter with a policy, which is read where the subject file says that it is."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from pytest_otmcp.core.finding import Finding
from pytest_otmcp.protocols.exercise import Asked
from pytest_otmcp.protocols.journal import JournalEntry
from pytest_otmcp.protocols.oracle import state_changing
from pytest_otmcp.trial.alteration import Alteration
from pytest_otmcp.trial.audit import Record, records_of, told_in
from pytest_otmcp.trial.check import Checks
from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.reply import Reply
from pytest_otmcp.trial.rig import Rig

from ..tasks.common import QUIET_S
from .fenced import approved_numbers, fenced, refused, written
from .steps import a_read_works, answers_again, exercise, faulty, nothing_arrived, refusal, silence, since

__all__ = ["TASKS"]

TASKS = Checks()

_SEEN_S = 2.0
"""Seconds within which a write that was asked for has reached the device."""
_TRIES = 5
"""So often the log is read anew where the device saw something else first."""
_ROOM = 40
"""Bytes of a record that a full log still takes: whatever is written then is torn."""
_SPELT = ("value", "values", "payload", "data")
"""Inputs of operations that are what is written."""

Lines = list[bytes]


def _audited(run: Repetition, governed: Rig) -> Mapping[str, Any]:
    audit = governed.subject.governance.audit
    if audit is None:
        run.not_applicable("the subject file does not say where the audit records are")
    return audit


async def _new(at: Rig, audit: Mapping[str, Any]) -> list[Record]:
    return records_of(await at.session.audit(), audit["fields"])


def _of_tool(records: Iterable[Record], tool: str) -> list[Record]:
    return [record for record in records if record.fields.get("tool") == tool]


def _finding(reply: Reply, code: str, what: str, requirement: str, records: Sequence[Record]) -> Finding:
    evidence = "\n".join(record.line for record in records) or "no new record"
    return Finding(code=code, message=f"{reply.label}: {what}", requirement=requirement, evidence=evidence[:2000])


@TASKS.every_protocol(
    "AUD-001", "Every attempt to write is in the audit log.", writes=True, launch="governance", having="fenced"
)
async def every_attempt_is_recorded(run: Repetition, at: Rig, governed: Rig) -> None:
    """Through an adapter with a policy and an audit log: write what is allowed, what is not, what the device refuses, and, where a person is
    asked, what this one declines and what it approves. Read the log after each.

    Said: as without a log; each answer names its record.
    Seen: for each call a record of its tool, with a time in UTC, the caller, a decision and an outcome, and the value. Allowed and denied have
        other decisions, done and failed other outcomes.
    Why: the question after an incident is who has tried what, and a log of what went well does not answer it.
    """
    audit, asks = _audited(run, governed), fenced(run, governed)
    log = _Log(run, governed, audit)
    await governed.session.answers("accept")
    await a_read_works(run, governed)
    await governed.session.audit()
    done = await log.of(await written(run, governed, asks.inside[0], requirement="AUD-001"), asks.inside[0])
    asked = asks.outside[0]
    denied = await log.of(await governed.call(asked.operation, **asked.inputs), asked)
    log.differ("decision", done, denied, "allowed and a denied")
    await governed.device.fault(*faulty(exercise(governed).writes, **refusal(governed)))
    asked = asks.inside[0]
    reply = await governed.call(asked.operation, role="control", **asked.inputs)
    await governed.device.fault()
    failed = await log.of(reply, asked)
    if reply.success is False:
        log.differ("outcome", done, failed, "successful and a failed")
    await answers_again(run, governed)
    if asks.way is not None and (governed.subject.governance.approval or {}).get("by") == "client":
        for answer, number in zip(("decline", "accept"), approved_numbers(run, governed, 2), strict=True):
            await governed.session.answers("decline" if answer == "decline" else "accept")
            await governed.session.audit()
            asked = asks.way(number)
            await log.of(await governed.call(asked.operation, **asked.inputs), asked)


class _Log:
    """The audit log of an adapter, read after each call."""

    def __init__(self, run: Repetition, at: Rig, audit: Mapping[str, Any]) -> None:
        self._run, self._at, self._audit = run, at, audit
        self._named: set[str] = set()

    async def of(self, reply: Reply, asked: Asked) -> tuple[Reply, list[Record]]:
        """Expect that a call has its record, and return what is new in the log about its tool."""
        every = await _new(self._at, self._audit)
        found = _of_tool(every, reply.tool)
        if not found:
            self._run.witnessed([_finding(reply, "not_audited", "the audit log has no record of it", "AUD-001", every)])
            return reply, []
        lacking = [name for name in ("principal", "decision", "outcome") if not self._says(found, name)]
        lacking += [] if all(record.in_utc for record in found) else ["time in UTC"]
        lacking += [] if self._has_value(found, reply, asked) else ["value"]
        anchor = told_in(reply, self._audit["anchor"])
        if reply.native and (not isinstance(anchor, str) or not anchor or anchor in self._named):
            lacking.append(f"name of its own, which the answer should have at {self._audit['anchor']}")
        self._named.add(str(anchor))
        if lacking:
            what = f"its audit records lack its {' and its '.join(lacking)}"
            self._run.witnessed([_finding(reply, "audit_incomplete", what, "AUD-001", found)])
        return reply, found

    def _says(self, records: Iterable[Record], name: str) -> bool:
        return any(record.fields.get(name) not in (None, "") for record in records)

    def _has_value(self, records: Iterable[Record], reply: Reply, asked: Asked) -> bool:
        told = self._at.arguments_of(asked.operation, **asked.inputs) or {}
        values = [reply.arguments.get(told[name]) for name in _SPELT if name in asked.inputs and name in told]
        text = "\n".join(record.line for record in records)
        return self._audit["digest"] or all(_is_in(value, text) for value in values)

    def differ(self, name: str, one: tuple[Reply, list[Record]], other: tuple[Reply, list[Record]], kinds: str) -> None:
        """Expect that the records of two calls say something else here."""
        said = [{json.dumps(r.fields.get(name)) for r in found} - {"null"} for _, found in (one, other)]
        if one[1] and other[1] and said[0] & said[1]:
            what = f"its audit records have the same {name} for a {kinds} call: {', '.join(sorted(said[0] & said[1]))}"
            records = [*one[1], *other[1]]
            self._run.witnessed([_finding(other[0], "audit_incomplete", what, "AUD-001", records)])


def _is_in(value: object, text: str) -> bool:
    """Tell whether a value is in a text, each number and each text of it."""
    if isinstance(value, list):
        return all(_is_in(one, text) for one in value)
    if isinstance(value, dict):
        return all(_is_in(one, text) for one in value.values())
    if isinstance(value, str):
        # Texts may be escaped, once or twice.
        return all(
            word in text for word in value.replace("\\", '"').split('"') if word.isascii() and word.isprintable()
        )
    return isinstance(value, bool) or json.dumps(value) in text or str(value) in text


@TASKS.every_protocol(
    "AUD-002", "Whoever changes the audit log is found out.", writes=True, launch="governance", having="fenced"
)
async def changes_of_the_log_are_found(run: Repetition, at: Rig, governed: Rig) -> None:
    """Through an adapter with a policy and an audit log: write; write with a further argument whose text is a whole record between line breaks.
    Then change the log as an attacker would: a record, its order, one less, one twice, its end cut off; and ask the vendor's verifier.

    Said: by the verifier, that the log is whole as it is, and that it is not after each change.
    Seen: every line of the log is a record, and none is the text of the argument.
    Why: a log that can be edited tells what its last editor wants; and its end is where an attack is.
    """
    audit, asks = _audited(run, governed), fenced(run, governed)
    if not (audit["is_file"] and audit["verifies"]):
        run.not_applicable("the subject file names no audit log that is a file with a verifier")
    await governed.session.answers("accept")
    await a_read_works(run, governed)
    await governed.session.audit()
    asked = asks.inside[0]
    reply = await written(run, governed, asked, requirement="AUD-002")
    first, tool = await _new(governed, audit), reply.tool
    if not _of_tool(first, tool):
        run.witnessed([_finding(reply, "not_audited", "the audit log has no record of it", "AUD-001", first)])
        return
    await _forge(run, governed, asked, first)
    for asked in asks.inside[:3]:
        reply = await written(run, governed, asked, requirement="AUD-002")
    anchor = told_in(reply, audit["anchor"])
    taken = await governed.session.verified("" if anchor is None else str(anchor), _edits(tool))
    for name in _edits(tool):
        whole = taken.get(name, False)
        if whole != (name == "whole"):
            taken_for = f"a log for whole of which {name}" if whole else "a log that nobody has changed for changed"
            unsaid = "" if anchor is not None else f"; the last answer has no anchor at {audit['anchor']}"
            found = f"its verifier takes {taken_for}{unsaid}"
            run.finding("not_tamper_evident", f"{governed.protocol}: {found}", requirement="AUD-002")


async def _forge(run: Repetition, at: Rig, asked: Asked, records: Sequence[Record]) -> None:
    if at.arguments_of(asked.operation, **asked.inputs) is None or not records:
        return
    forged = f"{records[-1].line[:-1]},{json.dumps('forged')}:true}}"
    text = f"x\n{forged}\n"
    reply = await at.call_altered(asked.operation, Alteration(given={"comment": text}), role="control", **asked.inputs)
    lines = await at.session.audit()
    broken = [line for line in lines if line == forged or not records_of([line], {"any": "@"})[0].fields]
    if broken:
        what = "a text of an argument has become a line of the audit log of its own"
        run.witnessed([_finding(reply, "not_tamper_evident", what, "AUD-002", [Record(broken[0], {})])])


def _edits(tool: str) -> dict[str, Callable[[Lines], Lines]]:
    """Return changes of a log by what they do, in words that follow "of which"; ``whole`` changes nothing."""

    def middle(lines: Lines) -> int:
        return len(lines) // 2

    def changed(lines: Lines) -> Lines:
        of_tool = [place for place, line in enumerate(lines) if tool.encode() in line]
        at = of_tool[len(of_tool) // 2]
        return [*lines[:at], lines[at].replace(tool.encode(), tool[::-1].encode()), *lines[at + 1 :]]

    def again(lines: Lines) -> Lines:
        return [*lines[: middle(lines)], lines[middle(lines) - 1], *lines[middle(lines) :]]

    def moved(lines: Lines) -> Lines:
        at = middle(lines)
        return [*lines[: at - 1], lines[at], lines[at - 1], *lines[at + 1 :]]

    return {
        "whole": lambda lines: lines,
        "a record was changed": changed,
        "a record was removed": lambda lines: [*lines[: middle(lines)], *lines[middle(lines) + 1 :]],
        "a record is there twice": again,
        "two records have changed places": moved,
        "the last record was cut off": lambda lines: lines[:-1],
    }


@TASKS.every_protocol(
    "AUD-003", "No write without its record on disk.", writes=True, launch="governance", having="fenced"
)
async def no_write_without_its_record(run: Repetition, at: Rig, governed: Rig) -> None:
    """Through an adapter with a policy and an audit log: write while the device takes requests and does not answer, and read the log as soon
    as the request is there; then, where the log is a file, let it grow no more, write and read; let it grow again, and write.

    Said: of the write while the log is full a failure with `audit_unavailable` and the outcome `not_sent`; success for the others.
    Seen: the record is on disk when the request has arrived; nothing arrives while the log is full.
    Why: a record that is made when all is over is not made when a process dies in between, and that is when it is needed.
    """
    audit, asks = _audited(run, governed), fenced(run, governed)
    await governed.session.answers("accept")
    await a_read_works(run, governed)
    asked = asks.inside[0]
    await written(run, governed, asked, requirement="AUD-003")
    await governed.session.audit()
    # Other values: outputs that do not change are no write to some devices.
    await _recorded_first(run, governed, audit, fenced(run, governed).inside[-1])
    if audit["is_file"] and await governed.session.cramp(_ROOM):
        call = partial(_while_full, governed)
        await refused(run, governed, call, asked, "audit_unavailable", requirement="AUD-003")
        await a_read_works(run, governed, requirement="AUD-003")
        await governed.session.cramp(None)
        await written(run, governed, asked, requirement="AUD-003")


async def _while_full(at: Rig, operation: str, **inputs: Any) -> Reply:
    return await at.call(operation, **inputs)


async def _recorded_first(run: Repetition, at: Rig, audit: Mapping[str, Any], asked: Asked) -> None:
    for attempt in range(_TRIES):
        reply, entries, lines = await _read_while_it_waits(at, asked)
        arrived = bool(nothing_arrived(at, entries, requirement="AUD-003"))
        records = records_of(lines, audit["fields"])
        await answers_again(run, at)
        if not arrived or _of_tool(records, reply.tool):
            return
        if attempt or await _tells_something_of_itself(at):
            # Something else that the adapter has to tell may have come first, and the log was read then.
            first = next(entry for entry in entries if entry["state_changing"])
            if not exercise(at).done([first], asked):
                continue
        what = "when its request had reached the device, the audit log had no record of it"
        run.witnessed([_finding(reply, "audited_too_late", what, "AUD-003", records)])
        return


async def _read_while_it_waits(at: Rig, asked: Asked) -> tuple[Reply, list[JournalEntry], list[str]]:
    """Write while the device is silent, and read the log as soon as it has seen a request that changes the plant; return the reply, what
    the device saw by then, and the lines."""
    lines: list[str] = []

    async def look() -> None:
        lines.extend(await at.session.audit())

    await at.device.fault(*faulty(exercise(at).changing or exercise(at).writes, **silence(at)))
    reply = await at.call_and_cancel(
        asked.operation, seen={"state_changing": True}, timeout_s=_SEEN_S, meanwhile=look, **asked.inputs
    )
    await at.device.fault()
    # On a busy machine the request may arrive after the log was read.
    soon = reply.exchange.sent_ns + int(_SEEN_S * 1e9 / 2)
    return reply, [entry for entry in since(reply, await at.journal()) if entry["t_ns"] <= soon], lines


async def _tells_something_of_itself(at: Rig) -> bool:
    """Watch an adapter that nobody calls; return whether it tells the device anything that may change the plant, such as a status."""
    before = len(await at.journal())
    await at.watch(QUIET_S)
    return bool(state_changing((await at.journal())[before:]))
