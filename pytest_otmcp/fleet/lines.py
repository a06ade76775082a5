"""The rows of the matrix: what became of each row of a plan in one line. A row is opened, checked, reduced, and let go."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.errors import UsageError
from ..protocols.registry import protocols
from .outcome import RECORD, RESULT, Outcome, Result, Tries, file_digest, judged, read_result
from .plan import RUNS, Kit, Plan

__all__ = ["Cell", "Line", "line", "lines", "objection"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """What a row says about one protocol: the level, the items that passed of how many, and the rules that are broken.

    The level is None where none is earned, and "not asked" where the requirement suite did not run.
    """

    level: str | None
    passed: int
    of: int
    broken: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A row of the matrix, as ``fleet.json`` has it.

    Attributes:
        key: of the row in its plan; None for a run that was given by itself.
        cells: by the name of the protocol; empty without a verdict.
        causes: the rules that are broken, each with the protocol.
        record: SHA-256 of ``run.json``.
        kit: that judged; None without a verdict.
        tries: how often the row was tried.
        folder: where report and certificate are, from the folder of the matrix.
    """

    key: str | None
    id: str
    version: str
    outcome: Outcome
    reason: str | None = None
    cells: dict[str, Cell] = field(default_factory=dict)
    causes: list[str] = field(default_factory=list)
    warnings: int = 0
    certificate: bool = False
    record: str | None = None
    kit: Kit | None = None
    tries: int = 1
    seconds: float | None = None
    folder: str | None = None


def line(result: Result, folder: str) -> Line:
    """Reduce a result to its line."""
    told = result.verdict
    return Line(
        key=result.key or None,
        id=result.id,
        version=result.version,
        outcome=result.outcome,
        reason=result.reason,
        cells={} if told is None else _cells(told),
        causes=[] if told is None else [f"{cause['protocol']} {cause['rule']}" for cause in told["causes"]],
        warnings=0 if told is None else told["warnings"],
        certificate=result.certificate,
        record=result.record,
        kit=None
        if told is None
        else Kit(**{name: told["kit"][name] for name in ("version", "digest", "suite_digest")}),
        tries=result.tries,
        seconds=result.seconds,
        folder=folder,
    )


def _cells(verdict: Mapping[str, Any]) -> dict[str, Cell]:
    keys = {protocol.name: key for key, protocol in protocols().items()}
    return {
        name: Cell(
            level=verdict["levels"].get(keys.get(name, name), "not asked"),
            passed=count["passed"],
            of=count["of"],
            broken=len({cause["rule"] for cause in verdict["causes"] if cause["protocol"] == name}),
        )
        for name, count in verdict["items"].items()
    }


def lines(plan: Plan, directory: Path, shown_as: str) -> Iterator[Line]:
    """Yield the rows of a fleet in the order of its plan, also those without a result.

    Args:
        directory: of the fleet.
        shown_as: the path of it from the matrix.

    Raises:
        UsageError: a result is not what the row has written.
    """
    for row in plan.rows:
        folder, shown = directory / RUNS / row.key, f"{shown_as}{RUNS}/{row.key}"
        if (folder / RESULT).is_file():
            try:
                result = read_result(folder)
            except ValueError as reason:
                raise UsageError(str(reason)) from None
            if (result.key, result.id, result.version) != (row.key, row.id, row.version):
                raise UsageError(f"{folder / RESULT} is about another row: {result.id} {result.version}")
            if result.verdict is not None and result.outcome is not judged(result.verdict):
                raise UsageError(
                    f"{folder / RESULT} says {result.outcome}, from its verdict follows {judged(result.verdict)}"
                )
            if result.outcome.is_judged and None in (result.verdict, result.record, result.packed):
                raise UsageError(
                    f"{folder / RESULT} says {result.outcome}, and not of which record that is the verdict"
                )
            if result.packed is not None and _digest(folder / RECORD) != result.packed:
                raise UsageError(f"{folder / RECORD} is not the record that {RESULT} is about")
            yield line(result, shown)
        else:
            tries, failed = Tries.of(directory, row.key).read()
            outcome = Outcome.FAULT if failed is not None and tries else Outcome.NOT_RUN
            yield Line(
                key=row.key, id=row.id, version=row.version, outcome=outcome, reason=failed, tries=tries, folder=shown
            )


def _digest(path: Path) -> str | None:
    return file_digest(path) if path.is_file() else None


def objection(found: Iterable[Line]) -> str | None:
    """Say why lines do not belong into one matrix; None when they do."""
    seen: set[tuple[str, str]] = set()
    records: dict[str | None, Line] = {}
    kit: Kit | None = None
    for one in found:
        name = f"{one.id} {one.version}"
        if (one.id, one.version) in seen:
            return f"{name} is there twice"
        seen.add((one.id, one.version))
        other = one if one.record is None else records.setdefault(one.record, one)
        if other is not one:
            return f"{other.id} {other.version} and {name} are the same run"
        kit = kit or one.kit
        if one.kit not in (None, kit):
            return f"{name} was judged by another kit than the rows before it: {one.kit}, not {kit}"
    return None
