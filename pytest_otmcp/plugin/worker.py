"""The worker's half of a run: every process that executes items has a :class:`Run` with a bench of its own."""

from __future__ import annotations

import asyncio
import traceback
from contextlib import suppress
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..core.verdict import Status

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..plant.devices import Plant
    from ..session.loop import LoopThread
    from ..subject import Subject
    from ..trial.bench import Bench
    from ..trial.task import Task
    from .options import RunSettings

__all__ = ["Run"]


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
            from ..core.errors import KitError, UsageError
            from ..plant.devices import Plant
            from ..session.loop import LoopThread
            from ..trial.gc_pause import settled

            wanted = self._stations()
            self._loop, self._plant = LoopThread(), Plant(self.settings.external)
            with settled():
                self._loop.run(self._plant.launch(wanted))
                # The MCP client takes as long to import as the devices take to start. Not on this thread: pydantic would
                # make an error of its own of Ctrl-C.
                self._loop.run(asyncio.to_thread(import_module, "pytest_otmcp.trial.bench"))
                from ..trial.adapter_under_test import BenchOptions
                from ..trial.bench import Bench

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
        from ..trial.applicability import applicability, stations

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
        from ..record.redaction import Redactor

        secrets = {secret for adapter in self.subject.adapters.values() for secret in adapter.secret_values()}
        result: dict[str, Any] = Redactor(secrets).apply(self._execute(task))
        return result

    def _execute(self, task: Task) -> dict[str, Any]:
        loop, bench = self._start()

        from ..trial.live_driver import LiveDriver
        from ..trial.trial import Trial

        planned = self.settings.repetitions[task.suite]
        report = partial(self.progress, task) if self.progress is not None else None
        driver = LiveDriver(bench, task, seed=self.settings.seed)
        trial = Trial(driver, task, planned, progress=report)
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
