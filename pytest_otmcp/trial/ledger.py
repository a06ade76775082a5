"""The ledger of one execution of a task's steps: judged calls, observations, journals and findings so far."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from ..core.finding import Finding, Kind, kind_of
from ..protocols.journal import JournalEntry
from ..record.schema import DeviceEntry, Observation, Role
from ..subject.model import READ_WRITE
from .alteration import Alteration
from .reply import Reply

__all__ = ["Entry", "Judged", "Ledger"]

Entry = JournalEntry
"""One journal entry; see the mocks' documentation for the fields of each protocol."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A reply and the task's judgement of it.

    Attributes:
        inputs: the inputs of the operation.
        role: ``task``, ``control``, ``setup``, ``warmup`` or ``recovery``; only ``task`` calls count for the benchmark.
        group: number of the calls that were made at the same time.
        altered: how the steps changed the arguments; None for a call as the subject file has it.
        ok: the call met its task's expectation; None until it has been judged.
        reachable: the device was there all the time.
        proof: the call proves where the session leads; the steps did not ask for it.
    """

    reply: Reply
    inputs: Mapping[str, object]
    role: Role
    group: int
    altered: Alteration | None = None
    ok: bool | None = None
    reachable: bool = True
    proof: bool = False


class Ledger:
    """Collector of what the rigs of a repetition report while the steps run.

    Args:
        role: role of the calls for which the steps name none.
        time_scale: factor on windows and deadlines.
        item: id of the task.
        origin: text from which random numbers of this execution are made.
        most_equal: how many findings of one kind are noted; None for all of them.
        at_real: the devices are real ones, where no value can be set.

    Attributes:
        calls: in the order of their replies.
        findings: of replies, devices and the task itself, in the order in which they were noted.
        journal: every entry of this repetition that has been kept so far, with its ``protocol`` and, of a read-only
            adapter, ``variant``.
        observations: the looks at devices.
        refused: why nothing may be written, so that the item ends; None as long as nothing was refused.
        inapplicable: why the steps found nothing to judge; None where they did.
    """

    def __init__(
        self,
        role: Role,
        time_scale: float,
        *,
        item: str = "",
        origin: str = "",
        most_equal: int | None = None,
        at_real: bool = False,
    ) -> None:
        self.role = role
        self.time_scale = time_scale
        self.item = item
        self.origin = origin
        self.at_real = at_real
        self.refused: Finding | None = None
        self.inapplicable: str | None = None
        self.calls: list[Judged] = []
        self.findings: list[Finding] = []
        self.observations: list[Observation] = []
        self.journal: list[DeviceEntry] = []
        self._group = 0
        self._together = False
        self._most_equal = most_equal
        self._kinds: Counter[Kind] = Counter()

    @property
    def repeats_itself(self) -> bool:
        """Whether a MUST was not met in the same way as often as is noted: more of the same shows nothing new."""
        return self._most_equal is not None and max(self._kinds.values(), default=0) >= self._most_equal

    def _note(self, findings: Iterable[Finding]) -> None:
        for finding in findings:
            kind = kind_of(finding.code, finding.requirement, finding.message)
            if self._most_equal is None or self._kinds[kind] < self._most_equal:
                self.findings.append(finding)
                self._kinds[kind] += finding.is_must

    def add(
        self,
        reply: Reply,
        inputs: Mapping[str, object],
        role: Role | None = None,
        *,
        reachable: bool = True,
        altered: Alteration | None = None,
    ) -> None:
        """Note a reply and its faults."""
        if not self._together:
            self._group += 1
        role = role or self.role
        self.calls.append(
            Judged(reply=reply, inputs=inputs, role=role, group=self._group, reachable=reachable, altered=altered)
        )
        self._note(reply.faults)

    def add_proof(self, reply: Reply, inputs: Mapping[str, object]) -> None:
        """Note a call that proves where the session leads: nothing is expected of its reply."""
        if not self._together:
            self._group += 1
        ok = bool(reply.success)
        self.calls.append(Judged(reply=reply, inputs=inputs, role="setup", group=self._group, ok=ok, proof=True))

    @contextmanager
    def one_group(self) -> Iterator[None]:
        """Count every call made inside the block as made at the same time."""
        self._group += 1
        self._together = True
        try:
            yield
        finally:
            self._together = False

    @property
    def failed(self) -> bool:
        """Whether a MUST was not met."""
        return any(finding.is_must for finding in self.findings)

    @property
    def together(self) -> bool:
        """Calls are being made at the same time."""
        return self._together

    def judge(self, reply: Reply, findings: Iterable[Finding]) -> bool:
        """Note the findings of the task's expectation of a reply; return whether it was met."""
        found = list(findings)
        met = not any(finding.is_must for finding in found) and not reply.faulty
        self._replace(reply, ok=met)
        # A missing reply, or one that is no envelope, has been reported as such.
        if not (reply.envelope is None and reply.faults):
            self._note(found)
        return met

    def reject(self, reply: Reply, finding: Finding) -> None:
        """Note that a reply that was judged before did not meet a further expectation."""
        self._replace(reply, ok=False)
        self._note([finding])

    def set_aside(self, reply: Reply) -> None:
        """Count a call as made during an outage: nothing is expected of it."""
        self._replace(reply, ok=True, role="recovery")

    def _replace(self, reply: Reply, **judgement: Any) -> None:
        for index in reversed(range(len(self.calls))):
            if self.calls[index].reply is reply:
                self.calls[index] = replace(self.calls[index], **judgement)
                return

    def explain(self, evidence: Mapping[int, str]) -> None:
        """Add evidence, found later, to findings.

        Args:
            evidence: ``id()`` of a finding to its evidence.
        """
        self.findings = [
            replace(finding, evidence=evidence[id(finding)]) if id(finding) in evidence else finding
            for finding in self.findings
        ]

    def caused_by(self, cause: str, codes: Collection[str]) -> None:
        """Name the cause of the findings with these codes, where none is named yet."""
        self.findings = [
            replace(finding, cause=cause) if finding.code in codes and finding.cause is None else finding
            for finding in self.findings
        ]

    def of(self, protocol: str, variant: str) -> list[Entry]:
        """Return the entries of one adapter's device that have been kept so far."""
        return [
            entry
            for entry in self.journal
            if (entry["protocol"], entry.get("variant", READ_WRITE)) == (protocol, variant)
        ]

    def observed(self, observation: Observation) -> None:
        """Note that the device of a rig was looked at."""
        self.observations.append(observation)

    def witnessed(self, *findings: Iterable[Finding]) -> None:
        """Take over findings of what was observed at the device."""
        for group in findings:
            self._note(group)

    def finding(self, code: str, message: str, requirement: str | None = None, evidence: str | None = None) -> None:
        """Note a finding of the task itself."""
        self._note([Finding(code=code, message=message, requirement=requirement, evidence=evidence)])
