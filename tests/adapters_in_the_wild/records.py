"""The run records behind ``docs/field-report.md``: where they lie, how one is made, and how it is read."""

from __future__ import annotations

import lzma
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

from pytest_otmcp.core.matrix import SUITES
from pytest_otmcp.record.condensed import condensed
from pytest_otmcp.record.reader import open_record
from pytest_otmcp.record.schema import Run
from pytest_otmcp.replay.rejudge import rejudge

from .examples import install

__all__ = ["REPS", "Unusable", "measure", "recorded", "stored"]

REPS = 30
"""Repetitions of the records: the paper's matrix."""

_RECORDS = Path(__file__).parents[2] / "docs" / "field-report"
_SUFFIX = ".json.xz"
_CACHE = Path.home() / ".cache" / "otmcp-field-report"
_JUDGED = (0, 1)
"""Exit codes of a run that says something about the adapter."""


class Unusable(Exception):
    """A run says nothing about the adapter, or is not judged again as it was; the message says why."""


def recorded() -> list[str]:
    """Return the names of the adapters that have a record."""
    return sorted(path.name.removesuffix(_SUFFIX) for path in _RECORDS.glob(f"*{_SUFFIX}"))


@cache
def stored(name: str) -> Run:
    """Read a record, which must be complete, unchanged and without contradiction; of like repetitions the first is whole."""
    with tempfile.TemporaryDirectory() as directory:
        plain = Path(directory, "run.json")
        plain.write_bytes(lzma.decompress(_place(name).read_bytes()))
        with open_record(plain) as run:
            return condensed(run)


def measure(name: str, reps: int = REPS) -> None:
    """Install an adapter, run benchmark and requirement suite with it, judge the run again, and keep its record.

    Raises:
        NotInstalled: the adapter cannot be had here.
        Unusable: the run is no evidence about the adapter.
    """
    subject = install(name, _CACHE)
    with tempfile.TemporaryDirectory() as directory:
        options = [f"--otmcp-subject={subject.name}", f"--otmcp-suite={','.join(SUITES)}", f"--otmcp-reps={reps}"]
        options.append(f"--otmcp-report-dir={directory}")
        suite = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--pyargs", "pytest_otmcp.conformance"]
        code = subprocess.run([*suite, *options], cwd=subject.parent, check=False).returncode
        if code not in _JUDGED:
            raise Unusable(f"{name}: the run ended with exit code {code}")
        record = Path(directory, "run.json")
        with open_record(record) as run:
            if objections := list(rejudge(run)):
                raise Unusable(f"{name}: judged again, the run is another: {objections[0]}")
        _place(name).parent.mkdir(exist_ok=True)
        _place(name).write_bytes(lzma.compress(record.read_bytes(), preset=9))
        stored.cache_clear()


def _place(name: str) -> Path:
    return _RECORDS / f"{name}{_SUFFIX}"
