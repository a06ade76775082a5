"""The controller's half of a run: collects the items of all workers, decides the verdict and writes ``run.json``.

With pytest-xdist the workers' results reach the controller as plain data on the test reports; only the controller writes.
"""

from __future__ import annotations

import os
import platform
import time
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..core.verdict import DeviationReport, ExitCode, Status, Verdict, decide, exit_code, judge_deviations
from ..protocols.external import external_devices
from ..protocols.registry import protocols
from ..suite.catalogue import kit_digest, suite_digest

if TYPE_CHECKING:
    from ..record.run_file import RunWriter
    from ..subject import Subject
    from .options import RunSettings

__all__ = ["RunRecorder"]

_PACKAGES = ("mcp", "pytest", "pytest-xdist")
"""Distributions whose versions a record states, beside those that the protocols name."""


class RunRecorder:
    """Collects results on the controller and writes ``run.json``.

    Args:
        settings, subject: of the run.
        required: ids of all items of the shipped suite, whatever was left of them after filters.
        narrowed: what narrowed or shadowed the suite; may grow until :meth:`finish`.
        workers: number of pytest-xdist workers, 0 for none.
        begun: monotonic time at which the session began.

    Raises:
        UsageError: the subject knows a deviation of an item that the suite does not have.
    """

    def __init__(
        self,
        settings: RunSettings,
        subject: Subject,
        *,
        required: list[str],
        narrowed: list[str],
        workers: int,
        begun: float,
    ) -> None:
        self.settings = settings
        self.required = required
        self.results: dict[str, dict[str, Any]] = {}
        self.facts: dict[str, dict[str, Any]] = {}
        self.verdict: Verdict | None = None
        self.deviations: DeviationReport | None = None
        self._subject = subject
        self._narrowed = narrowed
        self._workers = workers
        self._begun = begun
        self._started = datetime.now(UTC)
        self._writer: RunWriter | None = None
        # A deviation that no item can have is said now, not after the run.
        judge_deviations(subject.deviations, {}, required, self._started.date())

    @property
    def path(self) -> Path:
        """Where the record is written."""
        return self.settings.report_dir / "run.json"

    @property
    def elapsed_s(self) -> float:
        """Seconds since the session began."""
        return time.monotonic() - self._begun

    @property
    def missing(self) -> list[str]:
        """Items of the suite that have no result."""
        return [identifier for identifier in self.required if identifier not in self.results]

    @property
    def failures(self) -> int:
        """Items that pytest counts among its failures, if nobody interferes."""
        return sum(result["status"] not in (Status.PASS, Status.NOT_APPLICABLE) for result in self.results.values())

    def add(self, result: dict[str, Any], worker: str, facts: dict[str, Any]) -> bool:
        """Take an item's result and write it at once; False when there is one already, which stays."""
        from ..record.run_file import RunWriter

        if result["id"] in self.results:
            return False
        if self._writer is None:
            self.settings.report_dir.mkdir(parents=True, exist_ok=True)
            self._writer = RunWriter(self.path, self._header())
        self.results[result["id"]] = result
        self.facts[worker] = facts
        self._writer.append(result)
        return True

    def finish(self, *, interrupted: bool) -> None:
        """Decide the verdict and complete the record."""
        statuses = {identifier: Status(result["status"]) for identifier, result in self.results.items()}
        self.verdict = decide(statuses, self.required)
        known = self._subject.deviations
        self.deviations = judge_deviations(known, statuses, self.required, self._started.date())
        if self._writer is None:
            return
        missing = self.missing
        reason = None
        if interrupted:
            reason = "interrupted by the user"
        elif missing:
            reason = f"{len(missing)} of {len(self.required)} items did not run: {', '.join(missing)}"
        adapters: dict[str, Any] = {}
        spent: dict[str, float] = {}
        for facts in self.facts.values():
            adapters |= facts["adapters"]
            for what, seconds in facts["spent"].items():
                spent[what] = round(spent.get(what, 0.0) + seconds, 3)
        elapsed = self.elapsed_s
        if not self._workers:
            # What no span has claimed is the kit's as well: collection, pytest itself, writing the record.
            spent["kit"] = round(spent.get("kit", 0.0) + max(0.0, elapsed - sum(spent.values())), 3)
        self._writer.finish(
            {
                "complete": reason is None,
                "reason": reason,
                "items": len(self.results),
                "samples": sum(len(result["samples"]) for result in self.results.values()),
                "tool_calls": self._tool_calls(),
                "verdict": str(self.verdict),
                "deviations": self.deviations.as_record(),
                "elapsed_s": round(elapsed, 3),
                "breakdown_s": dict(sorted(spent.items())),
                "timing_valid": not self._workers,
            },
            adapters,
        )

    @property
    def exit_code(self) -> ExitCode:
        """What the run tells a shell, once it is finished."""
        assert self.verdict is not None
        return exit_code(self.verdict, self.deviations)

    def _tool_calls(self) -> dict[str, int]:
        from ..record.run_file import count_calls

        return count_calls(self.results.values())

    def _header(self) -> dict[str, Any]:
        settings = self.settings
        return {
            "schema": "otmcp-run/1",
            "kit": {
                "name": "pytest-otmcp",
                "version": __version__,
                "suite_digest": suite_digest(),
                "digest": kit_digest(),
            },
            "subject": {
                "name": self._subject.name,
                "version": self._subject.version,
                "digest": self._subject.digest,
                "deviations": [
                    {"item": entry.item, "reason": entry.reason, "expires": entry.expires.isoformat()}
                    for entry in self._subject.deviations
                ],
                "adapters": {},
            },
            "environment": {
                "python": platform.python_version(),
                "platform": f"{platform.system()} {platform.machine()}",
                "cpu_count": os.cpu_count(),
                "packages": {name: _version(name) for name in (*_PACKAGES, *_protocol_packages())},
                "started_at": self._started.isoformat(timespec="seconds").replace("+00:00", "Z"),
            },
            "settings": {
                "subject": settings.subject.name if settings.subject else None,
                "reps": settings.reps,
                "repetitions": settings.repetitions,
                "seed": settings.seed,
                "era": settings.era,
                "time_scale": settings.time_scale,
                "suites": list(settings.suites),
                "xdist_workers": self._workers,
                **{
                    device.option: settings.external.get(protocol, "embedded")
                    for protocol, device in external_devices().items()
                },
                # The same list until the end: what is noted while the run goes on is in the finished record.
                "narrowed": self._narrowed,
            },
        }


def _protocol_packages() -> list[str]:
    return [package for protocol in protocols().values() for package in protocol.packages]


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
