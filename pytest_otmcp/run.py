"""A run: the bench of this process, and, on the controller, the record that everything is reported from.

Every process that executes items has a :class:`Run`; with pytest-xdist the workers' results reach the controller as
plain data on the test reports, and only the controller writes.
"""

from __future__ import annotations

import asyncio
import os
import platform
import time
import traceback
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from importlib import import_module, metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import __version__
from .shipped import kit_digest, suite_digest
from .verdict import DeviationReport, ExitCode, Status, Verdict, decide, exit_code, judge_deviations

if TYPE_CHECKING:
    from collections.abc import Callable

    from .bench import Bench
    from .loop import LoopThread
    from .plant import Plant
    from .record import RunWriter
    from .settings import RunSettings
    from .subject import Subject
    from .task import Task

__all__ = ["Recorder", "Run"]

_PACKAGES = ("mcp", "pymodbus", "paho-mqtt", "asyncua", "protobuf", "pytest", "pytest-xdist")


class Run:
    """Executes tasks on a bench that is started when the first of them is.

    Args:
        settings, subject: of the run.
        tasks: what may be executed.
        shared: by other processes, too; nobody knows by whom which.
    """

    def __init__(self, settings: RunSettings, subject: Subject, tasks: list[Task], *, shared: bool) -> None:
        self.settings = settings
        self.subject = subject
        self.tasks = tasks
        self._shared = shared
        self.progress: Callable[[Task, int, int], None] | None = None
        self.unfinished: dict[str, Any] | None = None
        self._adapters: dict[str, Any] = {}
        self._loop: LoopThread | None = None
        self._plant: Plant | None = None
        self._bench: Bench | None = None

    def _start(self) -> tuple[LoopThread, Bench]:
        if self._loop is None or self._bench is None:
            from .errors import KitError, UsageError
            from .garbage import settled
            from .loop import LoopThread
            from .plant import Plant

            wanted = self._stations()
            self._loop, self._plant = LoopThread(), Plant(self.settings.broker)
            with settled():
                self._loop.run(self._plant.launch(wanted))
                # The MCP client takes as long to import as the devices take to start. Not on this thread: pydantic would
                # make an error of its own of Ctrl-C.
                self._loop.run(asyncio.to_thread(import_module, "pytest_otmcp.bench"))
                from .bench import Bench, BenchOptions

                options = BenchOptions(era=self.settings.era, time_scale=self.settings.time_scale)
                self._bench = Bench(self.subject, options, self._plant)
                # A mock that cannot be started is reported by every task that needs it.
                with suppress(KitError):
                    self._loop.run(self._bench.prepare(wanted))
            if drift := self._bench.drift():
                raise UsageError(f"{self.subject.source}: " + "; ".join(drift))
        return self._loop, self._bench

    def _stations(self) -> list[str]:
        """Adapter variants that the tasks will need; the read-write ones also where no task applies, to look at their tools."""
        from .applicability import applicability, stations

        adapters = self.subject.adapters
        wanted = {name for task in self.tasks for name in task.adapters if name in adapters}
        # Few tasks have a read-only variant. Where somebody else may get them, it is started with the first of them.
        for task in () if self._shared else self.tasks:
            if applicability(task, adapters) is None:
                wanted |= set(stations(task, adapters))
        return sorted(wanted)

    def execute(self, task: Task) -> dict[str, Any]:
        """Run a task; its result is what ``run.json`` has as an item, without the subject's secrets.

        Raises:
            UsageError: the subject file contradicts the tools that an adapter lists.
        """
        from .redaction import Redactor

        secrets = {secret for adapter in self.subject.adapters.values() for secret in adapter.secret_values()}
        result: dict[str, Any] = Redactor(secrets).apply(self._execute(task))
        return result

    def _execute(self, task: Task) -> dict[str, Any]:
        loop, bench = self._start()

        from .trial import Trial

        planned = self.settings.repetitions[task.suite]
        report = partial(self.progress, task) if self.progress is not None else None
        trial = Trial(bench, task, planned, seed=self.settings.seed, progress=report)
        try:
            return loop.run(trial.run())
        except KeyboardInterrupt:
            self.unfinished = trial.interrupted()
            raise
        except Exception as error:
            # Whatever the trial does not know how to end with is a bug of the kit, and says nothing about the adapter.
            finding = {
                "code": "kit_error",
                "message": f"{type(error).__name__}: {error}. This is the kit's fault; please file a bug.",
                "requirement": None,
                "evidence": "".join(traceback.format_exception(error))[-2000:],
            }
            return {**trial.interrupted(), "status": str(Status.KIT_ERROR), "findings": [finding]}

    def facts(self) -> dict[str, Any]:
        """What the controller wants to know of this process: its adapters and how its time was spent."""
        if self._bench is not None:
            self._adapters |= self._bench.facts()
            return {"adapters": self._adapters, "spent": dict(self._bench.spent.seconds)}
        return {"adapters": self._adapters, "spent": {}}

    def close(self) -> None:
        """End everything that runs."""
        if self._loop is not None:
            if self._bench is not None:
                self._loop.run(self._bench.close())
            if self._plant is not None:
                self._loop.run(self._plant.close())
            self._loop.close()
        self._loop = self._plant = self._bench = None


class Recorder:
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
        from .record import RunWriter

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
        from .record import count_calls

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
                "packages": {name: _version(name) for name in _PACKAGES},
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
                "broker": settings.broker or "embedded",
                # The same list until the end: what is noted while the run goes on is in the finished record.
                "narrowed": self._narrowed,
            },
        }


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
