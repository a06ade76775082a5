"""The trial of one task: set-up, warm-up, repetitions, closing checks; its result is an item of ``run.json``.

A trial is the same on a bench and on the stored history of a run: it decides what is done next and what the result means;
its driver does it, or looks up what was done (see ``driver``).
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal, cast

from ..core.errors import ExhaustedError, KitError, MeddledError, NoBindingError, SubjectError
from ..core.exhaustion import exhausted
from ..core.finding import Finding, Kind, kind_of
from ..protocols.registry import protocols
from ..protocols.unsolicited import nothing_commanded
from ..record.schema import Around, DeviceEntry, Ended, ItemBody, Role, Sample, State, ToolsChanged
from ..session.limits import TOO_LARGE
from ..subject.model import READ_WRITE
from .driver import SessionFacts, TrialDriver
from .every_call import EveryCall
from .ledger import Ledger
from .repetition import Repetition
from .rig import adapter_name
from .stored import stored_calls, stored_finding
from .strangers import Strangers
from .task import Steps, Task
from .unasked_writes import delivered_before

__all__ = ["Repetition", "Trial"]

_GIVE_UP_AFTER = 3
"""Consecutive repetitions without any reply after which an item is not continued: a hanging adapter is then found within
a few deadlines, not after thirty."""


_RULES: Mapping[str, str | None] = {
    "control_channel": None,
    "no_reply": "TMO-001",
    # It has started and listed its tools; what the subject file says of it besides is no requirement.
    "connect_step": None,
    "not_ready": None,
}
"""Codes of what ended an item, to the requirement that is not met then; it is MCP-002 for every other."""
_CHANGED: Mapping[ToolsChanged, str] = {
    "changed": "says something else",
    "announced": "says something else, as the adapter had announced,",
    "order": "has another order",
}


class _DisturbedError(Exception):
    """Another program has changed a device: what is seen there from now on says nothing about the adapter."""


ReportProgress = Callable[[int, int], None]


class _ItemOverError(Exception):
    """End of the item: nothing may be written, and the findings say why."""


class Trial:
    """One item of a run. :meth:`run` returns the item as ``run.json`` has it, without its samples.

    Args:
        driver: carries out the steps, or looks up what they showed.
        task: the task to run.
        planned: number of repetitions.
        keep: takes each sample as soon as there is one; the trial keeps none.
        progress: is told which repetition begins, and of how many.
    """

    def __init__(
        self,
        driver: TrialDriver,
        task: Task,
        planned: int,
        *,
        keep: Callable[[Sample], None],
        progress: ReportProgress | None = None,
    ) -> None:
        self._driver = driver
        self._task = task
        self._planned = planned
        self._progress = progress
        self._keep = keep
        self._all_passed = True
        self._findings: list[Finding] = []
        self._status: State | None = None
        self._reason: str | None = None
        self._ended: Ended | None = None
        self._around: list[Around] = []
        self._every_call: EveryCall | None = None
        self._warm_up: dict[Finding, Kind] = {}
        self._repeated: set[Kind] = set()
        self._strangers = Strangers()

    async def run(self) -> ItemBody:
        """Run the task to its end; faults of adapter and kit alike end up in the returned item."""
        obstacle = self._driver.obstacle()
        if obstacle is not None:
            status, self._reason = obstacle
            self._status = cast(State, str(status))
        else:
            with self._driver.spent("kit"):
                await self._guarded()
        return self._item()

    async def _guarded(self) -> None:
        try:
            await self._execute()
        except _DisturbedError as disturbance:
            # What was found before stands.
            if not self._failed:
                self._status = "KIT_ERROR"
            self._reason = str(disturbance)
        except _ItemOverError:
            pass
        except SubjectError as failure:
            self._end("subject", failure.code, str(failure), _RULES.get(failure.code, "MCP-002"))
            self._take(self._driver.told_at_start())
        except NoBindingError as gap:
            # What was found before stands.
            if not self._failed:
                self._status, self._reason = "NOT_TESTABLE", str(gap)
            self._end("binding", "not_testable", str(gap))
        except ExhaustedError as failure:
            self._status = "KIT_ERROR"
            self._end("kit", "exhausted", str(failure))
        except MeddledError as failure:
            self._status = "KIT_ERROR"
            self._end("kit", "meddled", str(failure))
        except KitError as failure:
            self._status = "KIT_ERROR"
            self._end("kit", "kit_error", str(failure))
        finally:
            # What a session that failed has become must not be the next item's problem.
            await self._driver.close(renew=self._failed)

    def _end(
        self, fault_of: Literal["subject", "binding", "kit"], code: str, message: str, requirement: str | None = None
    ) -> None:
        self._ended = {"fault_of": fault_of, "code": code, "message": message}
        if code == "kit_error":
            message = f"{message}. This is the kit's fault; please file a bug."
        self._findings.append(Finding(code=code, message=message, requirement=requirement))

    async def _execute(self) -> None:
        task, driver = self._task, self._driver
        try:
            await driver.prepare()
        finally:
            # It came before the item, whether or not the item's adapters can be started.
            self._judge_before()
        if task.begin is not None:
            await self._execute_around(task.begin, "setup")
        if task.warm_up:
            await self._execute_around(task.steps, "warmup")
        silent = 0
        for rep in range(self._planned):
            if self._progress is not None:
                self._progress(rep, self._planned)
            repetition = await self._repeat(rep)
            silent = silent + 1 if repetition.unanswered else 0
            if repetition.inapplicable is not None:
                # What was found before stands.
                if not self._failed:
                    self._status, self._reason = "NOT_APPLICABLE", repetition.inapplicable
                return
            if repetition.unanswered or repetition.ended_early:
                self._take(await driver.end_sessions())
            if silent == _GIVE_UP_AFTER and rep + 1 < self._planned:
                self._note("gave_up", f"not continued after {silent} repetitions in a row without a reply")
                return
            await driver.open_sessions()
        if task.end is not None:
            await self._execute_around(task.end, "control")
        self._take(await driver.inspect())
        if self._every_call is not None:
            history = driver.history()
            for finding in self._every_call.at_end(history["finished_at"], history["ended_ns"]):
                self._add(finding)

    async def _perform(self, repetition: Repetition, steps: Steps) -> Ledger:
        """Execute steps, and judge what holds for every call, whatever the task asks for."""
        await self._driver.perform(repetition, steps)
        if self._every_call is None:
            history = self._driver.history()
            self._every_call = EveryCall(history["started_at"], history["began_ns"])
        self._every_call.judge(repetition)
        return repetition.ledger

    def _judge_before(self) -> None:
        """Judge what reached the devices since the last item that had them."""
        for at, found in self._driver.history()["devices"].items():
            self._strangers.take(at, found["before"], watched=False)
        for protocol, entries, declared, asked_for in self._driver.before():
            again, others = delivered_before(entries, protocols()[protocol], asked_for=asked_for, item=self._task.id)
            for finding in again:
                self._add(finding)
            for finding in nothing_commanded(protocol, others, declared):
                when = "before this item, when nobody called the adapter"
                self._add(replace(finding, message=f"{protocol}: {when}: {finding.message}"))

    async def _execute_around(self, steps: Steps, role: Role) -> None:
        """Execute set-up, warm-up or closing checks: they are judged like a repetition, but are no sample."""
        repetition = self._driver.repetition(0, role)
        ledger = await self._perform(repetition, steps)
        self._around.append(
            {
                "role": role,
                "calls": stored_calls(ledger),
                "device": ledger.journal,
                "observations": ledger.observations,
            }
        )
        self._watch_strangers(ledger)
        if self._strangers.disturbance is not None:
            raise _DisturbedError(self._strangers.disturbance)
        for finding in ledger.findings:
            noted = self._add(replace(finding, message=f"{role}: {finding.message}"))
            if role == "warmup":
                self._warm_up[noted] = kind_of(finding.code, finding.requirement, finding.message)
        self._stop_if_refused(repetition)
        if repetition.unanswered:
            self._take(await self._driver.end_sessions())
            await self._driver.open_sessions()

    async def _repeat(self, rep: int) -> Repetition:
        repetition = self._driver.repetition(rep, "task")
        ledger = await self._perform(repetition, self._task.steps)
        self._watch_strangers(ledger)
        disturbance = self._strangers.disturbance
        findings = ledger.findings if disturbance is None else []
        passed = ledger.refused is None and not (ledger.failed and disturbance is None)
        self._all_passed = self._all_passed and passed
        self._repeated |= {kind_of(found.code, found.requirement, found.message) for found in findings}
        self._keep(
            {
                "repetition": rep,
                "ok": passed and disturbance is None,
                "duration_ms": round(repetition.duration_ms, 4),
                "calls": stored_calls(ledger),
                "device": ledger.journal,
                "observations": ledger.observations,
                "findings": [stored_finding(finding) for finding in findings],
                "phases": repetition.phases,
            }
        )
        if disturbance is not None:
            raise _DisturbedError(disturbance)
        self._stop_if_refused(repetition)
        return repetition

    def _watch_strangers(self, ledger: Ledger) -> None:
        slices: dict[str, list[DeviceEntry]] = {}
        for entry in ledger.journal:
            slices.setdefault(adapter_name(entry["protocol"], entry.get("variant", READ_WRITE)), []).append(entry)
        for at, entries in slices.items():
            self._strangers.take(at, entries)

    def _stop_if_refused(self, repetition: Repetition) -> None:
        refused = repetition.ledger.refused
        if refused is not None:
            self._findings.append(refused)
            raise _ItemOverError

    def _note(
        self, code: str, message: str, requirement: str | None = None, strength: Literal["MUST", "SHOULD"] = "MUST"
    ) -> Finding:
        return self._add(Finding(code=code, message=message, requirement=requirement, strength=strength))

    def _add(self, finding: Finding) -> Finding:
        """Note a finding once, and return the one that was noted."""
        for known in self._findings:
            if (finding.code, finding.message) == (known.code, known.message):
                return known
        self._findings.append(finding)
        return finding

    def _take(self, sessions: list[SessionFacts]) -> None:
        for facts in sessions:
            if facts.overflow:
                self._note("frame_too_long", f"the adapter sent {TOO_LARGE}", "ADR-009")
            if facts.died is not None:
                self._note("session_lost", facts.died, "MCP-007")
            if facts.overstayed is not None:
                self._note("does_not_exit", facts.overstayed, "MCP-009")
            for identifier in facts.unknown_ids:
                self._note("unknown_id", f"a response carries the id {identifier}, which no request had", "MCP-001")
            if facts.repeated_ids:
                said = f"{facts.protocol}: a request was answered more than once, the first: id {facts.repeated_ids[0]}"
                self._note("repeated_response", said, "MCP-001")
            if facts.too_deep:
                said = f"{facts.protocol}: {facts.too_deep} message(s) nested more deeply than the MCP client reads"
                self._note("frame_too_deep", said, "MCP-001")
            if facts.tools_changed is not None:
                said = f"{facts.protocol}: tools/list {_CHANGED[facts.tools_changed]} at the end of a session"
                self._note("tools_changed", said, "MCP-010", "MUST" if facts.tools_changed == "changed" else "SHOULD")
            for leak in facts.leaks:
                said = f"{facts.protocol}: {leak.place} has the value of {leak.variable}, {leak.form}"
                self._note("told_secret", said, "KEY-001")
            if facts.stray_lines:
                count, first = facts.stray_lines, facts.first_stray
                message = f"{count} line(s) on stdout that are no MCP message, the first: {first!r}"
                self._note("stdout_noise", f"{facts.protocol}: {message}", "MCP-001")

    def interrupted(self) -> ItemBody:
        """Return the item as far as it was measured when the user ended the run."""
        self._status = "INTERRUPTED"
        return self._item()

    def broken(self, error: Exception) -> ItemBody:
        """Return the item as far as it was measured when an exception ended it that is not the adapter's: a bug of the kit, or a
        machine that has run out of something."""
        self._status = "KIT_ERROR"
        if (cure := str(error) if isinstance(error, ExhaustedError) else exhausted(error)) is not None:
            self._findings = [Finding(code="exhausted", message=cure)]
        else:
            trace = "".join(traceback.format_exception(error))[-2000:]
            message = f"{type(error).__name__}: {error}. This is the kit's fault; please file a bug."
            self._findings = [Finding(code="kit_error", message=message, evidence=trace)]
        return self._item()

    @property
    def _failed(self) -> bool:
        return any(finding.is_must for finding in self._findings) or not self._all_passed

    def _item(self) -> ItemBody:
        task = self._task
        # What a repetition has found as well is said there.
        findings = [found for found in self._findings if self._warm_up.get(found) not in self._repeated]
        item: ItemBody = {
            "id": task.id,
            "suite": task.suite,
            "family": task.family,
            "title": task.title,
            "capabilities": list(task.capabilities),
            "requirements": list(task.requirements),
            "status": self._status or ("FAIL" if self._failed else "PASS"),
            "reason": self._reason,
            "planned": self._planned,
            "findings": [stored_finding(finding) for finding in findings],
            "requirement_rows": [],
            "timing_ms": dict(self._driver.timing_ms()),
            "around": self._around,
            "ended": self._ended,
            **self._driver.history(),
            "strangers": self._strangers.noted(),
        }
        if not item["strangers"]:
            del item["strangers"]
        return item
