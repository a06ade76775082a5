"""A run: the bench of this process, and, on the controller, the record that everything is reported from.

Every process that executes items has a :class:`Run`; with pytest-xdist the workers' results reach the controller as
plain data on the test reports, and only the controller writes.
"""

from __future__ import annotations

import hashlib
import os
import platform
import time
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from importlib import metadata, resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import __version__
from .verdict import Status, Verdict, decide

if TYPE_CHECKING:
    from collections.abc import Callable

    from .bench import Bench
    from .loop import LoopThread
    from .record import RunWriter
    from .settings import RunSettings
    from .subject import Subject
    from .task import Task

__all__ = ["Recorder", "Run"]

_PACKAGES = ("mcp", "pymodbus", "paho-mqtt", "asyncua", "protobuf", "pytest", "pytest-xdist")


class Run:
    """Executes tasks on a bench that is started when the first of them is."""

    def __init__(self, settings: RunSettings, subject: Subject, tasks: list[Task]) -> None:
        self.settings = settings
        self.subject = subject
        self.tasks = tasks
        self.progress: Callable[[Task, int, int], None] | None = None
        self.unfinished: dict[str, Any] | None = None
        self._adapters: dict[str, Any] = {}
        self._loop: LoopThread | None = None
        self._bench: Bench | None = None

    def _start(self) -> tuple[LoopThread, Bench]:
        if self._loop is None or self._bench is None:
            from .bench import Bench, BenchOptions
            from .errors import KitError
            from .loop import LoopThread

            options = BenchOptions(
                era=self.settings.era, time_scale=self.settings.time_scale, broker=self.settings.broker
            )
            self._loop = LoopThread()
            self._bench = Bench(self.subject, options)
            wanted = {name.split("@")[0] for task in self.tasks for name in task.adapters}
            # A mock that cannot be started is reported by every task that needs it.
            with suppress(KitError):
                self._loop.run(self._bench.prepare(sorted(wanted)))
        return self._loop, self._bench

    def execute(self, task: Task) -> dict[str, Any]:
        """Run a task; its result is what ``run.json`` has as an item."""
        from .trial import Trial

        planned = self.settings.repetitions[task.suite]
        loop, bench = self._start()
        report = partial(self.progress, task) if self.progress is not None else None
        trial = Trial(bench, task, planned, seed=self.settings.seed, progress=report)
        try:
            return loop.run(trial.run())
        except KeyboardInterrupt:
            self.unfinished = trial.interrupted()
            raise

    def facts(self) -> dict[str, Any]:
        """What the controller wants to know of this process: its adapters and how its time was spent."""
        if self._bench is not None:
            self._adapters |= self._bench.facts()
            return {"adapters": self._adapters, "spent": dict(self._bench.spent.seconds)}
        return {"adapters": self._adapters, "spent": {}}

    def close(self) -> None:
        """End everything that runs."""
        if self._loop is not None and self._bench is not None:
            self._loop.run(self._bench.close())
            self._loop.close()
        self._loop = self._bench = None


class Recorder:
    """Collects results on the controller and writes ``run.json``."""

    def __init__(self, settings: RunSettings, subject: Subject, *, workers: int) -> None:
        self.settings = settings
        self.results: dict[str, dict[str, Any]] = {}
        self.facts: dict[str, dict[str, Any]] = {}
        self.verdict: Verdict | None = None
        self.required: list[str] = []
        self._subject = subject
        self._workers = workers
        self._begun = time.monotonic()
        self._started_at = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
        self._writer: RunWriter | None = None

    @property
    def path(self) -> Path:
        """Where the record is written."""
        return self.settings.report_dir / "run.json"

    @property
    def elapsed_s(self) -> float:
        """Seconds since the run began."""
        return time.monotonic() - self._begun

    def add(self, result: dict[str, Any], worker: str, facts: dict[str, Any]) -> None:
        """Take an item's result and write it at once."""
        from .record import RunWriter

        if self._writer is None:
            self.settings.report_dir.mkdir(parents=True, exist_ok=True)
            self._writer = RunWriter(self.path, self._header())
        self.results[result["id"]] = result
        self.facts[worker] = facts
        self._writer.append(result)

    def finish(self, *, interrupted: bool) -> None:
        """Decide the verdict and complete the record."""
        statuses = {identifier: Status(result["status"]) for identifier, result in self.results.items()}
        self.verdict = decide(statuses, self.required)
        if self._writer is None:
            return
        missing = [identifier for identifier in self.required if identifier not in self.results]
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
                "elapsed_s": round(elapsed, 3),
                "breakdown_s": dict(sorted(spent.items())),
                "timing_valid": not self._workers,
            },
            adapters,
        )

    def _tool_calls(self) -> dict[str, int]:
        counts = dict.fromkeys(("task", "control", "setup", "warmup", "recovery"), 0)
        for result in self.results.values():
            calls = [call for sample in result["samples"] for call in sample["calls"]] + result["other_calls"]
            for call in calls:
                # The paper's count leaves the recovery suite out; so does the role "task".
                role = "recovery" if result["suite"] == "recovery" and call["role"] == "task" else call["role"]
                counts[role] += 1
        return counts

    def _header(self) -> dict[str, Any]:
        settings = self.settings
        return {
            "schema": "otmcp-run/1",
            "kit": {"name": "pytest-otmcp", "version": __version__, "suite_digest": suite_digest()},
            "subject": {"name": self._subject.name, "version": self._subject.version, "adapters": {}},
            "environment": {
                "python": platform.python_version(),
                "platform": f"{platform.system()} {platform.machine()}",
                "cpu_count": os.cpu_count(),
                "packages": {name: _version(name) for name in _PACKAGES},
                "started_at": self._started_at,
            },
            "settings": {
                "reps": settings.reps,
                "repetitions": settings.repetitions,
                "seed": settings.seed,
                "era": settings.era,
                "time_scale": settings.time_scale,
                "suites": list(settings.suites),
                "xdist_workers": self._workers,
                "broker": settings.broker or "embedded",
            },
        }


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def suite_digest() -> str:
    """SHA-256 over the conformance modules in this process's import path, so that a record tells which suite it ran."""
    digest = hashlib.sha256()
    root = resources.files("pytest_otmcp.conformance")
    for module in sorted(path.name for path in root.iterdir() if path.name.endswith(".py")):
        digest.update(module.encode() + b"\0" + (root / module).read_bytes() + b"\0")
    return "sha256:" + digest.hexdigest()
