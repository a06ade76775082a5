"""The controller's half of a run: it collects the items of all workers, decides the verdict and writes ``run.json``.

With pytest-xdist the workers' results reach the controller as plain data on the test reports; only the controller writes.
"""

from __future__ import annotations

import fcntl
import os
import platform
import secrets
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, cast

from .. import __version__
from ..core.errors import UsageError
from ..core.exhaustion import exhausted
from ..core.text import counted, recorded_name
from ..core.verdict import DeviationReport, ExitCode, Status, Verdict, decide, exit_code, judge_deviations
from ..core.walls import Wall
from ..protocols.external import DEVICE, external_devices
from ..protocols.registry import protocols
from ..record.schema import ROLES, SCHEMA
from ..record.tool_calls import added
from ..suite.catalogue import KIT, identity, kit_digest, suite_digest
from .interference import join_ids
from .worker import SPOOLS

if TYPE_CHECKING:
    from ..record.schema import AdapterFacts, Counted, Footer, Header, ItemHead, Settings
    from ..record.writer import RunWriter
    from ..subject.selection import Selection
    from .options import RunSettings
    from .results import ItemResult, Measured, WorkerFacts

__all__ = ["RunRecorder", "clear_unowned"]

_PACKAGES = ("mcp", "pytest", "pytest-xdist")
"""Distributions whose versions a record states, beside those that the protocols name."""


class Walled(TypedDict, total=False):
    """The member ``walls`` of a record's environment, where there is one."""

    walls: dict[Wall, str | None]


class RunRecorder:
    """Collector of the results on the controller, and writer of ``run.json``.

    Args:
        settings: of the run.
        selection: the adapters that it measures.
        required: ids, in the suite's order, of all items of the shipped suite, also of those that filters removed.
        narrowed: sentences on everything that narrowed or shadowed the suite; may grow until :meth:`finish`.
        workers: number of pytest-xdist workers, 0 for none.
        begun: monotonic time at which the session began.

    Attributes:
        not_measured: see :class:`~pytest_otmcp.subject.selection.Selection`.

    Raises:
        UsageError: the subject knows a deviation of an item that the suite does not have, nothing can be written to the report
            directory, or another run writes to it.
    """

    def __init__(
        self,
        settings: RunSettings,
        selection: Selection,
        *,
        required: list[str],
        narrowed: list[str],
        workers: int,
        begun: float,
    ) -> None:
        from ..report.render import clear

        self.settings = settings
        self.required = required
        self.statuses: dict[str, Status] = {}
        self._measured: list[Measured] = []
        self._facts: dict[str, WorkerFacts] = {}
        self._run_id = secrets.token_hex(16)
        self.verdict: Verdict | None = None
        self.deviations: DeviationReport | None = None
        self._subject = selection.subject
        self.not_measured = selection.not_measured
        self._narrowed = narrowed
        self._workers = workers
        self._begun = begun
        self._started = datetime.now(UTC)
        self._writer: RunWriter | None = None
        self._folder = _own(settings.report_dir)
        _clear(settings.report_dir / SPOOLS)
        # A deviation that no item can have is reported now, not after the run.
        judge_deviations(selection.subject.deviations, {}, required, self._started.date())
        clear(settings.report_dir)

    @property
    def path(self) -> Path:
        """Path of the record."""
        return self.settings.report_dir / "run.json"

    @property
    def elapsed_s(self) -> float:
        """Seconds since the session began."""
        return time.monotonic() - self._begun

    @property
    def missing(self) -> list[str]:
        """Items of the suite that have no result."""
        return [identifier for identifier in self.required if identifier not in self.statuses]

    @property
    def failures(self) -> int:
        """Items that pytest counts among its failures, if nobody interferes."""
        return sum(status not in (Status.PASS, Status.NOT_APPLICABLE) for status in self.statuses.values())

    def add(self, result: ItemResult, worker: str, facts: WorkerFacts) -> bool:
        """Take an item's result and write it at once; return False when the item has one already, which stays."""
        from ..record.writer import RunWriter, SampleSpool

        item, spool = result["item"], Path(result["spool"])
        if item["id"] in self.statuses:
            spool.unlink(missing_ok=True)
            return False
        if self._writer is None:
            self._writer = RunWriter(self.path, self._header())
        self._facts[worker] = facts
        head: ItemHead = {**item, "run_id": self._run_id, "order": self.required.index(item["id"])}
        self._writer.append(head, SampleSpool.read(spool, result["digest"]))
        spool.unlink(missing_ok=True)
        self.statuses[item["id"]] = Status(item["status"])
        self._measured.append(result["measured"])
        return True

    def finish(self, *, interrupted: str | None) -> None:
        """Decide the verdict and seal the record.

        Args:
            interrupted: what interrupted the run; None for a run that was not interrupted.
        """
        self.verdict = decide(self.statuses, self.required)
        known = self._subject.deviations
        self.deviations = judge_deviations(known, self.statuses, self.required, self._started.date())
        if self._writer is None:
            return
        with suppress(OSError):
            (self.settings.report_dir / SPOOLS).rmdir()
        missing = self.missing
        reason = interrupted
        if reason is None and missing:
            reason = self._describe_missing()
        spent: dict[str, float] = {}
        for facts in self._facts.values():
            for what, seconds in facts["spent"].items():
                spent[what] = round(spent.get(what, 0.0) + seconds, 3)
        elapsed = self.elapsed_s
        if not self._workers:
            # Time outside of every span counts as the kit's: collection, pytest itself, writing the record.
            spent["kit"] = round(spent.get("kit", 0.0) + max(0.0, elapsed - sum(spent.values())), 3)
        calls: Counter[Counted] = Counter(dict.fromkeys(ROLES, 0))
        for measured in self._measured:
            calls.update(measured["tool_calls"])
        footer: Footer = {
            "complete": reason is None,
            "reason": reason,
            "items": len(self.statuses),
            "samples": sum(measured["samples"] for measured in self._measured),
            "tool_calls": dict(calls),
            "verdict": str(self.verdict),
            "deviations": self.deviations.as_record(),
            "elapsed_s": round(elapsed, 3),
            "breakdown_s": dict(sorted(spent.items())),
            "timing_valid": not self._workers,
        }
        self._writer.finish(self._header(datetime.now(UTC)), footer)

    def _describe_missing(self) -> str:
        """Say which items about the subject's protocols have no result; those of suites that were not asked for are counted."""
        from ..suite.catalogue import all_tasks

        known, chosen = all_tasks(), self.settings.suites

        def spoken(name: str) -> bool:
            return name not in known or self._subject.adapters.keys() >= {*known[name].protocols}

        others = [name for name in self.missing if name in known and known[name].suite not in chosen]
        parts = [f"{counted(len(others), 'item')} of other suites did not run"] if others else []
        if wanted := [name for name in self.missing if name not in others and spoken(name)]:
            of = counted(len([*filter(spoken, self.required)]), "item")
            parts.append(f"{len(wanted)} of {of} did not run: {join_ids(wanted)}")
        if not parts:
            parts.append(f"{counted(len(self.missing), 'item')} about protocols without an adapter did not run")
        return "; ".join(parts)

    def close(self) -> None:
        """Let other runs have the report directory."""
        os.close(self._folder)

    @property
    def exit_code(self) -> ExitCode:
        """Exit code of the finished run."""
        assert self.verdict is not None
        return exit_code(self.verdict, self.deviations, statuses=self.statuses.values())

    def _header(self, finished: datetime | None = None) -> Header:
        settings = self.settings
        return {
            "schema": SCHEMA,
            "run_id": self._run_id,
            "kit": {
                "name": KIT,
                "version": __version__,
                "suite_digest": suite_digest(),
                "digest": kit_digest(),
                "protocols": [
                    identity(protocol)
                    for protocol in protocols().values()
                    if protocol.always or protocol.key in self._subject.adapters
                ],
            },
            "subject": {
                "name": recorded_name(self._subject.name),
                "version": recorded_name(self._subject.version),
                "digest": self._subject.digest,
                "deviations": [
                    {"item": entry.item, "reason": entry.reason, "expires": entry.expires.isoformat()}
                    for entry in self._subject.deviations
                ],
                "adapters": _merged(facts["adapters"] for facts in self._facts.values()),
            },
            "environment": {
                "python": platform.python_version(),
                "platform": f"{platform.system()} {platform.machine()}",
                "cpu_count": os.cpu_count(),
                "packages": {name: _version(name) for name in (*_PACKAGES, *_protocol_packages())},
                "started_at": _instant(self._started),
                "finished_at": None if finished is None else _instant(finished),
                **_walls(facts["walls"] for facts in self._facts.values()),
            },
            "settings": cast(
                "Settings",
                {
                    "subject": settings.subject.name if settings.subject else None,
                    "reps": settings.reps,
                    "repetitions": settings.repetitions,
                    "seed": settings.seed,
                    **({} if settings.challenge is None else {"challenge": settings.challenge}),
                    "era": settings.era,
                    "time_scale": settings.time_scale,
                    "soak": settings.soak,
                    "suites": list(settings.suites),
                    "protocols": list(settings.protocols),
                    "not_measured": dict(self.not_measured),
                    "xdist_workers": self._workers,
                    **{
                        device.option: settings.external.get(protocol, "embedded")
                        for protocol, device in external_devices().items()
                        if device.option != DEVICE
                    },
                    **({"devices": settings.devices} if settings.devices else {}),
                    # The same list until the end, so that the finished record has what is noted during the run.
                    "narrowed": self._narrowed,
                },
            ),
            "devices": {name: device for facts in self._facts.values() for name, device in facts["devices"].items()},
        }


def _own(directory: Path) -> int:
    """Make the report directory this run's as long as the run lasts; return a descriptor of it, which holds the lock.

    Raises:
        UsageError: it cannot be made or written to, or it is another run's.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory) as probe:
            probe.write(b"a record must fit in here")
        descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        reason = exhausted(error) or error.strerror or error
        raise UsageError(f"--otmcp-report-dir: {directory} cannot be written to: {reason}") from None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise UsageError(
            f"--otmcp-report-dir: another run is writing to {directory}; wait for its end, or choose another directory"
        ) from None
    return descriptor


def clear_unowned(directory: Path) -> None:
    """Remove record and reports of an earlier run, unless another run is writing there."""
    from ..report.render import clear

    if directory.is_dir():
        with suppress(UsageError):
            descriptor = _own(directory)
            clear(directory)
            os.close(descriptor)


def _clear(spools: Path) -> None:
    """Remove samples that a killed run has left, or a link, which leads elsewhere."""
    if spools.is_symlink():
        spools.unlink()
    else:
        shutil.rmtree(spools, ignore_errors=True)


def _instant(moment: datetime) -> str:
    return moment.isoformat(timespec="seconds").replace("+00:00", "Z")


def _walls(workers: Iterable[Mapping[Wall, str | None]]) -> Walled:
    """Return the record's account of the walls: each must have stood in every process that had adapters."""
    told = [walls for walls in workers if walls]
    if not told:
        return {}
    why = {wall: dict.fromkeys(filter(None, (walls[wall] for walls in told))) for wall in told[0]}
    return {"walls": {wall: "; ".join(sentences) or None for wall, sentences in why.items()}}


def _merged(workers: Iterable[Mapping[str, AdapterFacts]]) -> dict[str, AdapterFacts]:
    """Merge the adapters of all workers: each has opened its own sessions and used some of the subject's bindings."""
    merged: dict[str, AdapterFacts] = {}
    for adapters in workers:
        for key, facts in adapters.items():
            known = merged.setdefault(key, facts)
            calls = added([facts] if known is facts else [known, facts])
            told = facts if known["tools"] is None else known
            bindings = {**known["bindings"], **facts["bindings"]}
            unmet, listing = sorted({*known["unmet"], *facts["unmet"]}), {**known["listing"], **facts["listing"]}
            merged[key] = {**told, "bindings": bindings, "unmet": unmet, "listing": listing}
            if calls:
                merged[key]["calls"] = calls
    return dict(sorted(merged.items()))


def _protocol_packages() -> list[str]:
    return [package for protocol in protocols().values() for package in protocol.packages]


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
