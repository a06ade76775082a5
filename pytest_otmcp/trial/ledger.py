"""What one execution of a task's steps has shown so far: replies, observations, journals, findings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from ..core.finding import Finding
from ..protocols.journal import JournalEntry
from .reply import Reply

__all__ = ["Entry", "Ledger"]

Entry = JournalEntry
"""One journal entry; see the mocks' documentation for the fields of each protocol."""


class Ledger:
    """Collects; the rigs of a repetition write into it while the steps run.

    Args:
        role: what calls count as when the steps do not say otherwise.
        time_scale: factor on windows and deadlines.

    Attributes:
        replies, inputs: the calls, in the order of their replies, and the inputs of each.
        findings: of replies, devices and the task itself, in the order in which they came up.
        journal: every entry of this repetition that has been kept so far, with its ``protocol`` and, of a read-only adapter, ``variant``.
        observations: what was looked at; see :mod:`pytest_otmcp.record.images`.
    """

    def __init__(self, role: str, time_scale: float) -> None:
        self.role = role
        self.time_scale = time_scale
        self.replies: list[Reply] = []
        self.inputs: list[Mapping[str, Any]] = []
        self.findings: list[Finding] = []
        self.observations: list[dict[str, Any]] = []
        self.journal: list[dict[str, Any]] = []
        self._group = 0
        self._together = False

    def add(self, reply: Reply, inputs: Mapping[str, Any]) -> None:
        """Note a reply and its faults."""
        if not self._together:
            self._group += 1
        reply.group = self._group
        self.replies.append(reply)
        self.inputs.append(inputs)
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

    def observed(self, at: str, what: str, seen: Any) -> None:
        """Note that the device of the rig ``at`` was looked at; see :mod:`pytest_otmcp.record.images`."""
        self.observations.append({"at": at, what: seen})

    def witnessed(self, *findings: Iterable[Finding]) -> None:
        """Take over what the device witnesses."""
        for group in findings:
            self.findings.extend(group)

    def finding(self, code: str, message: str, requirement: str | None = None, evidence: str | None = None) -> None:
        """Note a finding of the task itself."""
        self.findings.append(Finding(code=code, message=message, requirement=requirement, evidence=evidence))
