"""The worker's half of a run: every process that executes items has a :class:`Run` with a bench of its own."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import partial
from importlib import import_module
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING
from uuid import uuid4

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine
    from typing import Any

    from ..plant.devices import Plant
    from ..record.redaction import Redactor
    from ..record.schema import ItemBody, Sample
    from ..session.isolation import Isolation
    from ..session.loop import LoopThread
    from ..subject import Subject
    from ..trial.bench import Bench
    from ..trial.task import Task
    from ..trial.under_way import UnderWay
    from .options import RunSettings
    from .results import ItemResult, WorkerFacts

__all__ = ["SPOOLS", "Run"]

SPOOLS = "run.parts"
"""Folder in the report directory for the samples of items that are not in the record yet."""

_TOLD_EVERY_S = 1.0


class Run:
    """Executor of tasks on a bench, which is started with the first task.

    Args:
        settings, subject: of the run.
        tasks: the tasks that may be executed.
        worker: name of this process where other processes may execute some of these tasks (which ones is not known in
            advance); None where there are no other processes.

    Attributes:
        progress: called with task, number and planned number of a repetition that begins, or None.
        waiting: called every second of an item with its task, its seconds so far and what it waits for; or None.
        starting: called with the numbers of running devices and adapters, of all devices, and of all adapters, while they
            start; or None.
        unfinished: the item that was interrupted, or None.
    """

    def __init__(self, settings: RunSettings, subject: Subject, tasks: list[Task], *, worker: str | None) -> None:
        self.settings = settings
        self.subject = subject
        self.tasks = tasks
        self._worker = worker
        self.progress: Callable[[Task, int, int], None] | None = None
        self.waiting: Callable[[Task, float, str], None] | None = None
        self.starting: Callable[[int, int, int], None] | None = None
        self.unfinished: ItemResult | None = None
        self._declared_secrets = {secret for adapter in subject.adapters.values() for secret in adapter.secret_values()}
        self._facts: WorkerFacts = {"adapters": {}, "devices": {}, "spent": {}, "walls": {}}
        self._loop: LoopThread | None = None
        self._plant: Plant | None = None
        self._bench: Bench | None = None
        self._isolation: Isolation | None = None
        self._prepared: set[str] = set()

    def _start(self, task: Task) -> tuple[LoopThread, Bench]:
        if self._loop is None or self._bench is None:
            from ..core.errors import KitError
            from ..plant.devices import Plant
            from ..session.isolation import Isolation
            from ..session.keeper import hide_memory
            from ..session.loop import LoopThread
            from ..trial.gc_pause import settled

            # What is judged is in this process's memory, and its environment is not for adapters.
            hide_memory()
            wanted = self._adapters_of(task) if self._starts_few else self._adapters_needed()
            if self.starting is not None:
                self.starting(0, len(wanted), len(wanted))
            self._isolation = Isolation(self.settings.isolation)
            outside = {protocol: adapter.openings.why_outside for protocol, adapter in self.subject.adapters.items()}
            self._loop, self._plant = (
                LoopThread(),
                Plant(self.settings.external, self._isolation, outside, self.settings.consents, self.settings.mirror),
            )
            with settled():
                self._loop.run(self._plant.launch(wanted))
                # The MCP client takes as long to import as the devices take to start. It is imported on another thread:
                # on this one pydantic would turn a Ctrl-C into an error of its own.
                self._loop.run(asyncio.to_thread(import_module, "pytest_otmcp.trial.bench"))
                from ..trial.adapter_under_test import MAIN, BenchOptions
                from ..trial.bench import Bench

                options = BenchOptions(
                    era=self.settings.era,
                    time_scale=self.settings.time_scale,
                    soak=self.settings.soak,
                    devices=self.settings.devices,
                    worker=self._worker or MAIN,
                )
                self._bench = Bench(self.subject, options, self._plant)
                # The bounds of the verdict need it. While the adapters start, this process only waits.
                ahead = Thread(target=_import_ahead, args=("scipy.special",), daemon=True)
                if self._worker is None:
                    ahead.start()
                # A mock that cannot be started is reported by every task that needs it.
                with suppress(KitError):
                    self._loop.run(self._bench.prepare(wanted, started=self.starting))
                    self._loop.check()
                self._prepared.update(wanted)
                if self._worker is None:
                    # It parses signatures, and before Python 3.11.8 and 3.12.2 two threads that parse at the same time fail now and
                    # then (python/cpython issue 106905): this one is about to parse the kit's files.
                    ahead.join()
            self._check_drift(self._bench)
        elif self._starts_few and (wanted := self._adapters_of(task)):
            from ..core.errors import KitError

            with suppress(KitError):
                self._loop.run(self._bench.prepare(wanted))
                self._loop.check()
            self._prepared.update(wanted)
            self._check_drift(self._bench)
        return self._loop, self._bench

    @property
    def _starts_few(self) -> bool:
        """A worker begins with the adapters of its own items alone. A mistake in a subject file is to be said before the first item."""
        return self._worker is not None and self.settings.subject is None

    def _check_drift(self, bench: Bench) -> None:
        from ..core.errors import UsageError

        if drift := bench.drift():
            raise UsageError(f"{self.subject.source}: " + "; ".join(drift))

    def _adapters_of(self, task: Task) -> list[str]:
        """Return the adapters that a task of a worker needs and that it has not started. Few tasks need a read-only variant: it is started
        with the first of them that applies."""
        from ..trial.applicability import why_not_in_field

        if why_not_in_field(task, self.settings.devices) is not None:
            return []
        return sorted({name for name in task.adapters if name in self.subject.adapters} - self._prepared)

    def _adapters_needed(self) -> list[str]:
        """Return the adapter variants that the tasks need; read-write variants also where no task applies, for their tools."""
        from ..trial.applicability import applicability, participants, why_not_in_field

        adapters = self.subject.adapters
        tasks = [task for task in self.tasks if why_not_in_field(task, self.settings.devices) is None]
        wanted = {name for task in tasks for name in task.adapters if name in adapters}
        for task in tasks:
            if applicability(task, adapters) is None:
                wanted |= set(participants(task, adapters))
        return sorted(wanted)

    def execute(self, task: Task) -> ItemResult:
        """Run a task; each sample is written to a file at once, without the subject's secrets.

        Raises:
            UsageError: the subject file contradicts the tools that an adapter lists.
            ExhaustedError: the machine has run out of something before the task could begin.
        """
        from ..core.errors import ExhaustedError
        from ..core.exhaustion import exhausted

        try:
            return self._execute(task, *self._start(task))
        except (OSError, RuntimeError, MemoryError) as error:
            if (cure := exhausted(error)) is not None:
                raise ExhaustedError(f"{task.id} could not begin: {cure}") from error
            raise

    def _execute(self, task: Task, loop: LoopThread, bench: Bench) -> ItemResult:
        from ..core.errors import ExhaustedError, MeddledError
        from ..core.exhaustion import exhausted
        from ..record.writer import SampleSpool
        from ..trial.live_driver import LiveDriver
        from ..trial.trial import Trial
        from .results import Tally

        folder = self.settings.report_dir / SPOOLS
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            # It was there when the run began.
            reason = exhausted(error) or error.strerror
            raise ExhaustedError(f"{folder} cannot be made any more: {reason}") from error
        # Plugins that repeat tests may execute the same item twice.
        spool = SampleSpool(folder / f"{task.id}-{uuid4().hex}.jsonl")
        tally = Tally(task.id, task.suite)
        writing, told = Lock(), Event()

        def keep(sample: Sample) -> None:
            # Whoever ends a run twice does not wait for the trial, which ends on the loop's thread.
            with writing:
                if not told.is_set():
                    redacted = self._redactor().apply(sample)
                    try:
                        spool.add(redacted)
                    except OSError as error:
                        if exhausted(error) is not None:
                            raise
                        raise MeddledError(
                            f"the samples of the item cannot be written any more ({error.strerror}): another program has moved or replaced "
                            "what is in the report directory, as an adapter can do"
                        ) from error
                    tally.add(sample)

        def result(item: ItemBody) -> ItemResult:
            with writing:
                told.set()
            redactor = self._redactor()
            measured = redactor.apply(tally.measured(item))
            return {
                "item": redactor.apply(item),
                "measured": measured,
                "spool": str(spool.path),
                "digest": spool.digest,
            }

        planned = self.settings.repetitions.get(task.suite, 1)
        report = partial(self.progress, task) if self.progress is not None else None
        driver = LiveDriver(bench, task, seed=self.settings.seed)
        trial = Trial(driver, task, planned, keep=keep, progress=report)
        try:
            item = loop.run(self._shown(trial.run(), task, bench))
            loop.check()
            return result(item)
        except KeyboardInterrupt:
            self.unfinished = result(trial.interrupted())
            raise
        except Exception as error:
            # An unexpected exception is a bug of the kit, not of the adapter.
            return result(trial.broken(error))

    async def _shown(self, running: Coroutine[Any, Any, ItemBody], task: Task, bench: Bench) -> ItemBody:
        """Return what ``running`` returns; meanwhile tell each second what the item waits for."""
        if self.waiting is None:
            return await running
        bench.under_way.begin()
        telling = asyncio.create_task(_tell_each_second(partial(self.waiting, task), bench.under_way))
        try:
            return await running
        finally:
            telling.cancel()

    def _redactor(self) -> Redactor:
        from ..record.redaction import Redactor

        # Of the random secrets only those need to be taken out that an adapter has told.
        return Redactor(self._declared_secrets | (self._bench.told_secrets() if self._bench is not None else set()))

    def facts(self) -> WorkerFacts:
        """Return what the controller has to know about this process."""
        if self._bench is not None:
            redactor = self._redactor()
            self._facts = {
                "adapters": redactor.apply(self._bench.adapters()),
                "devices": self._bench.devices(),
                "spent": dict(self._bench.spent.seconds),
                "walls": {} if self._isolation is None else self._isolation.account(),
            }
        return self._facts

    def close(self) -> None:
        """End the sessions, the devices and the loop.

        Raises:
            UnrestoredError: a real device did not get its old values back.
        """
        try:
            if self._loop is not None:
                if self._bench is not None:
                    self._loop.run(self._bench.close())
                if self._plant is not None:
                    self._loop.run(self._plant.close())
        finally:
            if self._loop is not None:
                self._loop.close()
            if self._isolation is not None:
                self._isolation.close()
            self._loop = self._plant = self._bench = self._isolation = None


async def _tell_each_second(waiting: Callable[[float, str], None], under_way: UnderWay) -> None:
    while True:
        await asyncio.sleep(_TOLD_EVERY_S)
        waiting(under_way.seconds, under_way.words())


def _import_ahead(module: str) -> None:
    # What fails here for want of descriptors or memory is tried again, and reported, where the module is needed.
    with suppress(OSError, ImportError, MemoryError):
        import_module(module)
