"""The reports of a run record, or the comparison of several, written below a directory.

The records may be hostile. :mod:`pytest_otmcp.cli.confined` runs this in a process with bounded memory and time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.errors import ExhaustedError, UsageError
from ..core.exhaustion import exhausted
from ..core.text import counted, printable
from ..core.verdict import ExitCode
from ..record.condensed import condensed
from ..record.reader import RecordError, open_record
from ..record.schema import Run
from . import Refusal, cut

__all__ = ["answer", "compare", "write"]

_SHOWN = 8
"""Items with a change that the terminal names."""


def answer(asked: Mapping[str, Any]) -> dict[str, Any]:
    """Write what a JSON value asks for, and return what there is to say as a JSON value."""
    records, directory = [Path(name) for name in asked["records"]], Path(asked["directory"])
    told = write(records[0], directory) if len(records) == 1 else compare(records, directory)
    return {"said": list(map(cut, told))}


def write(record: Path, directory: Path) -> Iterator[str]:
    """Write every report of a record, also of a run that is not complete.

    Raises:
        Refusal: the file is no record that can be believed, or a report could not be made of it; the others were written.
        UsageError: a report could not be written to its place.
        ExhaustedError: the machine has run out of something.
        MemoryError: this process has run out of memory.
    """
    from ..report.render import reason, write_all

    failed = write_all(_run(record), directory)
    told = "; ".join(f"{directory / name} was not written: {reason(error)}" for name, error in failed.items())
    for error in failed.values():
        if isinstance(error, MemoryError):
            raise error
        if exhausted(error) is not None:
            raise ExhaustedError(told)
    if failed and all(isinstance(error, OSError) for error in failed.values()):
        raise UsageError(told)
    if failed:
        raise Refusal(
            f"{cut(told)}; if `otmcp verify` accepts the record, this is a fault of the kit, please file a bug",
            ExitCode.INDETERMINATE,
        )
    yield f"the reports of {record} are in {directory}"


def compare(records: Sequence[Path], directory: Path) -> Iterator[str]:
    """Write the comparison of several records.

    Raises:
        Refusal: one of the files is no record that can be believed.
    """
    from ..report.comparison_pages import NAMES, write_comparison

    comparison = write_comparison([_run(record) for record in records], directory)
    names = [printable(column.name) for column in comparison.columns]
    width = max(map(len, names))
    for name, column in zip(names, comparison.columns, strict=True):
        yield f"{name:<{width}}  {column.verdict.text}, {column.passed} runs passed"
    changes, partial = comparison.changes, comparison.partial
    shown = [*changes[:_SHOWN], *(["..."] if changes[_SHOWN:] else [])]
    yield f"{counted(len(changes), 'item')} went differently{': ' if changes else ''}{'; '.join(shown)}"
    if partial:
        yield f"{counted(partial, 'item')} {'was' if partial == 1 else 'were'} judged in some of the runs only"
    yield f"{' and '.join(str(directory / name) for name in NAMES)} have the matrix"


def _run(record: Path) -> Run:
    try:
        with open_record(record, allow_incomplete=True) as stored:
            return condensed(stored)
    except RecordError as error:
        raise Refusal(cut(f"no reports: {error}")) from None
