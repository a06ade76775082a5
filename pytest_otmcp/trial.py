"""Runs one task: set-up, warm-up, repetitions, closing checks; gathers replies, journal slices and findings.

The judging itself is done by the pure functions of ``oracle`` and ``witness``; a trial only collects what they say.
"""

from __future__ import annotations

import asyncio
import base64
import random
import time
from collections.abc import Awaitable, Callable, Coroutine, Iterable
from dataclasses import dataclass, field
from typing import Any

from . import oracle
from .bench import READ_ONLY, READ_WRITE, Bench, NoBindingError, Station
from .envelope import same_json
from .errors import KitError, SubjectError
from .findings import Finding
from .mcp_session import McpSession
from .observation import Reply
from .plant import Entry
from .task import Task

__all__ = ["AtDevice", "Repetition", "Trial"]

_GIVE_UP_AFTER = 3
"""Consecutive repetitions without any reply after which an item is not continued: a hanging adapter is a finding
within a few deadlines, not after thirty."""

Progress = Callable[[int, int], None]


class _UnansweredError(Exception):
    """A call got no response: the rest of the repetition would only wait for one deadline after the other."""


class AtDevice:
    """One adapter at its device, as the steps of a repetition see it."""

    def __init__(self, repetition: Repetition, station: Station) -> None:
        self._repetition = repetition
        self.station = station
        self.device = station.device
        self._since = station.mark

    async def call(self, operation: str, *, role: str | None = None, **inputs: Any) -> Reply:
        """Perform an operation; see :meth:`Station.call`."""
        reply = await self.station.call(operation, role=role or self._repetition.role, **inputs)
        self._repetition.add(reply)
        if reply.wire.response is None:
            raise _UnansweredError
        return reply

    async def journal(self) -> list[Entry]:
        """What reached the device, and what it answered, since this repetition began."""
        with self._repetition.spent("observing the device"):
            return (await self.device.journal(self._since)).entries

    async def wait_for(self, *, timeout_s: float, count: int = 1, **match: Any) -> list[Entry]:
        """The journal entries of this repetition that match, as soon as there are ``count``, or when time is over."""
        with self._repetition.spent("observing the device"):
            scale = self._repetition.time_scale
            return await self.device.wait(self._since, match, timeout_s=timeout_s * scale, count=count)

    async def image(self) -> dict[str, Any]:
        """What the device really holds."""
        with self._repetition.spent("observing the device"):
            return await self.device.image()

    async def poke(self, **params: Any) -> None:
        """Set a value out of band."""
        with self._repetition.spent("observing the device"):
            await self.device.poke(**params)

    async def tick(self, steps: int) -> None:
        """Let ``steps`` seconds of plant time pass."""
        with self._repetition.spent("observing the device"):
            await self.device.tick(steps)

    async def session_journal(self) -> list[Entry]:
        """The device's journal since the adapter's session was opened, or since the device was started if that was
        later."""
        with self._repetition.spent("observing the device"):
            return (await self.device.journal(self.station.session_mark)).entries

    async def publish_from_kit(self, topic: str, payload: bytes) -> None:
        """Let the broker publish a message that does not come from the adapter, QoS 0, not retained."""
        message = {"topic": topic, "payload": base64.b64encode(payload).decode(), "qos": 0, "retain": False}
        await self.poke(publish=message)

    async def stays_quiet(self, seconds: float, judge: Callable[[list[Entry]], list[Finding]]) -> None:
        """Watch the device for a while, then judge what reached it; for things that must not happen."""
        with self._repetition.spent("quiet windows"):
            await asyncio.sleep(seconds * self._repetition.time_scale)
        self._repetition.witnessed(judge(await self.journal()))

    async def stop_device(self) -> float:
        """Kill the device process; what its journal held is kept with this repetition. Milliseconds it took."""
        await self._repetition.keep_journal(self)
        begun = time.monotonic()
        with self._repetition.spent("endpoint restarts"):
            await self.device.stop()
        return (time.monotonic() - begun) * 1000

    async def start_device(self) -> float:
        """Start a new device process on the same port. Milliseconds until it accepted connections."""
        begun = time.monotonic_ns()
        with self._repetition.spent("endpoint restarts"):
            await self.device.start()
        self._since = self.station.mark = self.station.session_mark = 0
        return (self.device.accepting_ns - begun) / 1e6

    async def fresh_session(self) -> McpSession:
        """End the station's session and process, and start anew; the new session is the station's from now on."""
        with self._repetition.spent("adapter starts"):
            session = self.station.session
            if session is not None:
                report = await session.close()
                if report is not None and report.how in ("terminated", "killed"):
                    self._repetition.finding(
                        "does_not_exit",
                        f"{self.station.adapter.protocol}: the adapter did not exit within {report.seconds:.1f} s of "
                        f"its stdin closing and had to be {report.how}",
                        requirement="MCP-009",
                    )
            await self.station.open()
        assert self.station.session is not None
        return self.station.session

    async def close_session(self) -> None:
        """End the station's session and its process."""
        with self._repetition.spent("adapter starts"):
            await self.station.close()

    async def call_until_success(self, operation: str, *, window_s: float, **inputs: Any) -> list[Reply]:
        """Call until the adapter succeeds or the window, counted from the moment the device accepts connections,
        is over. Only the last call has the repetition's role; those before it have the role ``recovery``.
        """
        end = self.device.accepting_ns + int(window_s * self._repetition.time_scale * 1e9)
        replies = []
        while True:
            reply = await self.call(operation, **inputs)
            replies.append(reply)
            if reply.success or time.monotonic_ns() >= end:
                return replies
            reply.role = "recovery"
            reply.ok = True
            # An adapter may reconnect in its own time: a new connection is the sign to ask again, at the latest
            # after a pause that keeps an adapter which fails at once from being hammered.
            seen = len(await self.device.wait(0, {"kind": "CONNECTED"}, timeout_s=0.0))
            await self.device.wait(0, {"kind": "CONNECTED"}, timeout_s=0.05, count=seen + 1)

    async def take_slice(self) -> list[Entry]:
        """The journal since the repetition began; the next repetition's slice begins where this one ends."""
        if not self.device.running:
            return []
        journal = await self.device.journal(self._since)
        self.station.mark = self._since = journal.next
        return journal.entries


class Repetition:
    """One execution of a task's steps, and everything it showed."""

    def __init__(self, trial: Trial, rep: int, role: str) -> None:
        self._trial = trial
        self.rep = rep
        self.role = role
        # The same seed gives the same nonces, whatever else ran before.
        self.rng = random.Random(f"{trial.seed}/{trial.task.id}/{role}/{rep}")
        self.replies: list[Reply] = []
        self.findings: list[Finding] = []
        self.phases: dict[str, Any] | None = None
        self.notes: dict[str, Any] = {}
        self._kept: list[Entry] = []
        self._group = 0
        self._together = False
        self._at: dict[tuple[str, str], AtDevice] = {}
        for key, station in trial.stations.items():
            self._at[key] = AtDevice(self, station)

    # -- who there is -------------------------------------------------------------------------------------

    @property
    def modbus(self) -> AtDevice:
        """The Modbus adapter with writes enabled."""
        return self._at["modbus", READ_WRITE]

    @property
    def modbus_ro(self) -> AtDevice:
        """The Modbus adapter with writes disabled, at a device of its own."""
        return self._at["modbus", READ_ONLY]

    @property
    def mqtt(self) -> AtDevice:
        """The MQTT adapter."""
        return self._at["mqtt", READ_WRITE]

    @property
    def opcua(self) -> AtDevice:
        """The OPC UA adapter."""
        return self._at["opcua", READ_WRITE]

    def at(self, protocol: str) -> AtDevice:
        """The adapter of ``protocol`` with writes enabled."""
        return self._at[protocol, READ_WRITE]

    @property
    def all(self) -> Iterable[AtDevice]:
        """Every adapter at its device that this task has."""
        return self._at.values()

    @property
    def time_scale(self) -> float:
        """Factor on windows and deadlines."""
        return self._trial.bench.options.time_scale

    # -- collecting ---------------------------------------------------------------------------------------

    def spent(self, what: str) -> Any:
        """Context manager that counts its time as spent on ``what``."""
        return self._trial.bench.spent.on(what)

    def add(self, reply: Reply) -> None:
        """Note a reply and its faults."""
        if not self._together:
            self._group += 1
        reply.group = self._group
        self.replies.append(reply)
        self.findings.extend(reply.faults)

    async def in_order(self, *calls: Coroutine[Any, Any, Reply]) -> list[Reply]:
        """Perform calls one after the other."""
        replies = []
        for index, call in enumerate(calls):
            try:
                replies.append(await call)
            except BaseException:
                for unused in calls[index + 1 :]:
                    unused.close()
                raise
        return replies

    async def together(self, *calls: Coroutine[Any, Any, Reply]) -> list[Reply]:
        """Perform calls concurrently; their time counts once, from the first request to the last reply."""
        self._group += 1
        self._together = True
        try:
            replies = await asyncio.gather(*calls, return_exceptions=True)
        finally:
            self._together = False
        for reply in replies:
            if isinstance(reply, BaseException):
                raise reply
        return [reply for reply in replies if isinstance(reply, Reply)]

    async def keep_journal(self, at: AtDevice) -> None:
        """Keep what a device's journal holds before its process ends."""
        self._kept.extend({"protocol": at.station.adapter.protocol, **entry} for entry in await at.take_slice())

    async def close_journals(self) -> list[Entry]:
        """Every journal entry of this repetition."""
        for at in self._at.values():
            await self.keep_journal(at)
        return self._kept

    # -- judging ------------------------------------------------------------------------------------------

    def succeeds(self, reply: Reply, **outputs: Any) -> None:
        """Expect success with these outputs."""
        self._judge(reply, oracle.succeeded(reply, **outputs))

    def fails(self, reply: Reply, *codes: str, **expected: Any) -> None:
        """Expect a refusal with one of these codes; see :func:`pytest_otmcp.oracle.failed`."""
        self._judge(reply, oracle.failed(reply, *codes, **expected))

    def one_of(self, reply: Reply, output: str, *values: Any) -> None:
        """Expect an output to be one of several values, where concurrency makes each of them right."""
        found = reply.outputs.get(output)
        if reply.success and not any(same_json(value, found) for value in values):
            reply.ok = False
            shown = " or ".join(map(repr, values))
            self.finding(
                "wrong_value", f"{reply.label}: {output} should be {shown}, the reply says {found!r}", "CON-004"
            )

    def _judge(self, reply: Reply, findings: list[Finding]) -> None:
        reply.ok = not findings and not reply.faults
        # A reply that never came, or is no envelope, has been reported as such.
        if not (reply.envelope is None and reply.faults):
            self.findings.extend(findings)

    def witnessed(self, *findings: list[Finding]) -> None:
        """Take over what the device witnesses."""
        for group in findings:
            self.findings.extend(group)

    def finding(self, code: str, message: str, requirement: str | None = None, evidence: str | None = None) -> None:
        """Note a finding of the task itself."""
        self.findings.append(Finding(code=code, message=message, requirement=requirement, evidence=evidence))

    @property
    def unanswered(self) -> bool:
        """Some call got no response at all."""
        return any(reply.wire.response is None for reply in self.replies)

    @property
    def duration_ms(self) -> float:
        """Time of the task's calls: the sum over sequential calls, concurrent ones counted once."""
        return sum(self._spans("task")) / 1e6

    def calls_s(self) -> float:
        """Seconds spent in calls of any role."""
        return sum(self._spans(None)) / 1e9

    def _spans(self, role: str | None) -> Iterable[int]:
        groups: dict[int, list[Reply]] = {}
        for reply in self.replies:
            if (role is None or reply.role == role) and reply.wire.received_ns is not None:
                groups.setdefault(reply.group, []).append(reply)
        for replies in groups.values():
            last = max(reply.wire.received_ns or 0 for reply in replies)
            yield last - min(reply.wire.sent_ns for reply in replies)


@dataclass(slots=True)
class Trial:
    """One item of a run. :meth:`run` returns the item as ``run.json`` has it."""

    bench: Bench
    task: Task
    planned: int
    seed: int = 0
    progress: Progress | None = None
    stations: dict[tuple[str, str], Station] = field(default_factory=dict)
    _samples: list[dict[str, Any]] = field(default_factory=list)
    _findings: list[Finding] = field(default_factory=list)
    _status: str | None = None
    _other_calls: list[Reply] = field(default_factory=list)

    async def run(self) -> dict[str, Any]:
        """Run the task to its end; faults of adapter and kit alike end up in the returned item."""
        missing = [name for name in self.task.adapters if name.split("@")[0] not in self.bench.subject.adapters]
        before = dict(self.bench.spent.seconds)
        if missing:
            self._status = "NOT_APPLICABLE"
        else:
            with self.bench.spent.on("kit"):
                await self._guarded()
        return self._item(before)

    async def _guarded(self) -> None:
        try:
            await self._execute()
        except SubjectError as failure:
            self._findings.append(Finding(code=failure.code, message=str(failure), requirement="MCP-002"))
        except NoBindingError as gap:
            self._status = "NOT_TESTABLE"
            self._findings.append(Finding(code="not_testable", message=str(gap)))
        except KitError as failure:
            self._status = "KIT_ERROR"
            self._findings.append(
                Finding(code="kit_error", message=f"{failure}. This is the kit's fault; please file a bug.")
            )
        finally:
            if READ_ONLY in {variant for _, variant in self.stations}:
                await self._close_read_only()

    async def _execute(self) -> None:
        with self.bench.spent.on("plant start"):
            for name in self.task.adapters:
                protocol, _, variant = name.partition("@")
                key = (protocol, variant or READ_WRITE)
                self.stations[key] = await self.bench.station(*key)
        for station in self.stations.values():
            await station.device.reset()
            station.mark = await station.device.mark()
        await self._open_sessions()
        if self.task.begin is not None:
            await self._around(self.task.begin, "setup")
        if self.task.warm_up:
            await self._around(self.task.steps, "warmup")
        silent = 0
        for rep in range(self.planned):
            if self.progress is not None:
                self.progress(rep, self.planned)
            repetition = await self._repeat(rep)
            silent = silent + 1 if repetition.unanswered else 0
            if repetition.unanswered:
                await self._replace_broken()
            if silent == _GIVE_UP_AFTER and rep + 1 < self.planned:
                self._note("gave_up", f"not continued after {silent} repetitions in a row without a reply")
                return
            await self._open_sessions()
        if self.task.end is not None:
            await self._around(self.task.end, "control")
        self._stdout_purity()

    async def _open_sessions(self) -> None:
        with self.bench.spent.on("adapter starts"):
            for station in self.stations.values():
                await station.open()

    async def _replace_broken(self) -> None:
        # A call that hangs may spread to the next ones: whoever did not answer starts afresh, and says how it ended.
        for station in self.stations.values():
            session = station.session
            if session is None:
                continue
            if session.overflow:
                self._note("frame_too_long", "the adapter sent a message longer than 16 MiB", "ADR-009")
            elif session.died:
                self._note("session_lost", await session.death_note(), "MCP-007")
            for identifier in session.unknown_responses():
                self._note("unknown_id", f"a response carries the id {identifier}, which no request had", "MCP-001")
            self._stdout_purity()
            with self.bench.spent.on("adapter starts"):
                await station.close()

    def _note(self, code: str, message: str, requirement: str | None = None) -> None:
        finding = Finding(code=code, message=message, requirement=requirement)
        if finding not in self._findings:
            self._findings.append(finding)

    def _stdout_purity(self) -> None:
        for station in self.stations.values():
            if station.session is None:
                continue
            count, first = station.session.stray_output()
            if count:
                message = f"{count} line(s) on stdout that are no MCP message, the first: {first[0]!r}"
                self._note("stdout_noise", f"{station.adapter.protocol}: {message}", "MCP-001")

    async def _close_read_only(self) -> None:
        with self.bench.spent.on("adapter starts"):
            for (_, variant), station in self.stations.items():
                if variant == READ_ONLY:
                    await station.close()

    async def _around(self, steps: Callable[[Repetition], Awaitable[None]], role: str) -> None:
        """Set-up, warm-up and closing checks: judged like a repetition, but not a sample."""
        repetition = Repetition(self, 0, role)
        await self._steps(repetition, steps)
        await repetition.close_journals()
        self._other_calls.extend(repetition.replies)
        for finding in repetition.findings:
            self._note(finding.code, f"{role}: {finding.message}", finding.requirement)
        if repetition.unanswered:
            await self._replace_broken()
            await self._open_sessions()

    async def _steps(self, repetition: Repetition, steps: Callable[[Repetition], Awaitable[None]]) -> None:
        try:
            await steps(repetition)
        except _UnansweredError:
            for at in repetition.all:
                if not at.device.running:
                    await at.start_device()
        finally:
            seconds = repetition.calls_s()
            self.bench.spent.move("kit", "tool calls", seconds)

    async def _repeat(self, rep: int) -> Repetition:
        repetition = Repetition(self, rep, "task")
        await self._steps(repetition, self.task.steps)
        with self.bench.spent.on("observing the device"):
            entries = await repetition.close_journals()
        self._samples.append(
            {
                "repetition": rep,
                "ok": not repetition.findings,
                "duration_ms": round(repetition.duration_ms, 4),
                "calls": [reply.as_record() for reply in repetition.replies],
                "device": entries,
                "findings": [_finding(finding) for finding in repetition.findings],
                "phases": repetition.phases,
            }
        )
        return repetition

    def interrupted(self) -> dict[str, Any]:
        """The item as far as it was measured when the user ended the run."""
        self._status = "INTERRUPTED"
        return self._item({})

    def _item(self, before: dict[str, float]) -> dict[str, Any]:
        failed = bool(self._findings) or any(not sample["ok"] for sample in self._samples)
        spent = {
            what: round((seconds - before.get(what, 0.0)) * 1000, 3)
            for what, seconds in self.bench.spent.seconds.items()
            if seconds - before.get(what, 0.0) > 0
        }
        return {
            "id": self.task.id,
            "suite": self.task.suite,
            "family": self.task.family,
            "title": self.task.title,
            "requirements": list(self.task.requirements),
            "status": self._status or ("FAIL" if failed else "PASS"),
            "planned": self.planned,
            "samples": self._samples,
            "other_calls": [reply.as_record() for reply in self._other_calls],
            "findings": [_finding(finding) for finding in self._findings],
            "timing_ms": spent,
        }


def _finding(finding: Finding) -> dict[str, Any]:
    return {
        "code": finding.code,
        "message": finding.message,
        "requirement": finding.requirement,
        "evidence": finding.evidence,
    }
