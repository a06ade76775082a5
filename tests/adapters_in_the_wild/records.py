"""The run records behind ``docs/field-report.md``: where they lie, whence they come, and how one is read."""

from __future__ import annotations

import gzip
import lzma
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from pytest_otmcp.core.text import counted
from pytest_otmcp.fleet.lines import lines
from pytest_otmcp.fleet.outcome import RECORD
from pytest_otmcp.fleet.plan import RUNS, read_plan
from pytest_otmcp.record.condensed import condensed
from pytest_otmcp.record.reader import open_record
from pytest_otmcp.record.schema import Run

from .examples import EXAMPLES
from .rejudged import rejudged

__all__ = ["RECORDS", "REPS", "judge_again", "recorded", "stored", "take"]

REPS = 30
"""Repetitions of the records: the paper's matrix."""

RECORDS = Path(__file__).parents[2] / "docs" / "field-report"
_SUFFIX = ".json.xz"


def recorded() -> list[str]:
    """Return the names of the adapters that have a record."""
    return sorted(path.name.removesuffix(_SUFFIX) for path in RECORDS.glob(f"*{_SUFFIX}"))


@cache
def stored(name: str) -> Run:
    """Read a record, which must be complete, unchanged and without contradiction; of like repetitions the first is whole."""
    with tempfile.TemporaryDirectory() as directory:
        plain = Path(directory, "run.json")
        plain.write_bytes(lzma.decompress(_place(name).read_bytes()))
        with open_record(plain) as run:
            return condensed(run)


def take(fleet: Path) -> Iterator[str]:
    """Keep the records of a fleet of ``docs/examples/fleet.toml``, those of the versions that the examples name; say of each row what became of it.

    A record that is another than the one that was verified where the row ran is refused.
    """
    for row in lines(read_plan(fleet), fleet, ""):
        if row.version != _version(row.id):
            continue
        if row.record is None:
            yield f"{row.id}: {row.outcome}: {row.reason}; its record stays as it is"
            continue
        with gzip.open(fleet / RUNS / str(row.key) / RECORD) as record:
            _place(row.id).write_bytes(lzma.compress(record.read(), preset=9))
        yield f"{row.id}: {row.outcome}"
    stored.cache_clear()


def judge_again(names: Iterable[str]) -> Iterator[str]:
    """Judge the evidence of records by this kit, and keep what it says; say of each what became of it."""
    for name in names:
        with tempfile.TemporaryDirectory() as directory:
            plain, fresh = Path(directory, "run.json"), Path(directory, "again.json")
            plain.write_bytes(lzma.decompress(_place(name).read_bytes()))
            with open_record(plain) as run:
                changed, objections = rejudged(run, fresh)
            if objections:
                yield f"{name}: has to be measured again, its record stays as it is: {objections[0]}"
                continue
            _place(name).write_bytes(lzma.compress(fresh.read_bytes(), preset=9))
            yield f"{name}: {counted(changed, 'difference')}"
    stored.cache_clear()


def _version(name: str) -> str:
    file = EXAMPLES / name / "otmcp.toml"
    return str(tomllib.loads(file.read_text(encoding="utf-8"))["subject"]["version"])


def _place(name: str) -> Path:
    return RECORDS / f"{name}{_SUFFIX}"
