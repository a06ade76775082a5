"""What one execution of a task's steps has shown so far: judged calls, observations, journals, findings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from ..core.finding import Finding
from ..protocols.journal import JournalEntry
from ..record.schema import DeviceEntry, Observation, Role
from .reply import Reply

__all__ = ["Entry", "Judged", "Ledger"]

Entry = JournalEntry
"""One journal entry; see the mocks' documentation for the fields of each protocol."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A reply and what the task made of it.

    Attributes:
        inputs: what the operation was asked for with.
        role: ``task``, ``control``, ``setup``, ``warmup`` or ``recovery``; only ``task`` calls count for the benchmark.
        group: number of the calls that were made at the same time.
        ok: the call met its task's expectation; None until it has been judged.
    """

    reply: Reply
    inputs: Mapping[str, object]
    role: Role
    group: int
    ok: bool | None = None


class Ledger:
    """Collects what the rigs of a repetition write while the steps run.

    Args:
        role: what calls count as when the steps do not say otherwise.
        time_scale: factor on windows and deadlines.

    Attributes:
        calls: in the order of their replies.
        findings: of replies, devices and the task itself, in the order in which they came up.
        journal: every entry of this repetition that has been kept so far, with its ``protocol`` and, of a read-only adapter, ``variant``.
        observations: what was looked at.
    """

    def __init__(self, role: Role, time_scale: float) -> None:
        self.role = role
        self.time_scale = time_scale
        self.calls: list[Judged] = []
        self.findings: list[Finding] = []
        self.observations: list[Observation] = []
        self.journal: list[DeviceEntry] = []
        self._group = 0
        self._together = False

    def add(self, reply: Reply, inputs: Mapping[str, object], role: Role | None = None) -> None:
        """Note a reply and its faults."""
        if not self._together:
            self._group += 1
        self.calls.append(Judged(reply=reply, inputs=inputs, role=role or self.role, group=self._group))
        self.findings.extend(reply.faults)

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
    def together(self) -> bool:
        """Calls are being made at the same time."""
        return self._together

    def judge(self, reply: Reply, findings: Iterable[Finding]) -> bool:
        """Note what the task's expectation of a reply came to; return whether it was met."""
        found = list(findings)
        met = not found and not reply.faults
        self._replace(reply, ok=met)
        # A reply that never came, or is no envelope, has been reported as such.
        if not (reply.envelope is None and reply.faults):
            self.findings.extend(found)
        return met

    def reject(self, reply: Reply, finding: Finding) -> None:
        """Note that a reply that was judged before did not meet a further expectation."""
        self._replace(reply, ok=False)
        self.findings.append(finding)

    def set_aside(self, reply: Reply) -> None:
        """Count a call as one of those during an outage, of which nothing is expected."""
        self._replace(reply, ok=True, role="recovery")

    def _replace(self, reply: Reply, **judgement: Any) -> None:
        for index in reversed(range(len(self.calls))):
            if self.calls[index].reply is reply:
                self.calls[index] = replace(self.calls[index], **judgement)
                return

    def explain(self, evidence: Mapping[int, str]) -> None:
        """Give findings the evidence that came to light after them.

        Args:
            evidence: ``id()`` of a finding to its evidence.
        """
        self.findings = [
            replace(finding, evidence=evidence[id(finding)]) if id(finding) in evidence else finding
            for finding in self.findings
        ]

    def observed(self, observation: Observation) -> None:
        """Note that the device of a rig was looked at."""
        self.observations.append(observation)

    def witnessed(self, *findings: Iterable[Finding]) -> None:
        """Take over what the device witnesses."""
        for group in findings:
            self.findings.extend(group)

    def finding(self, code: str, message: str, requirement: str | None = None, evidence: str | None = None) -> None:
        """Note a finding of the task itself."""
        self.findings.append(Finding(code=code, message=message, requirement=requirement, evidence=evidence))
