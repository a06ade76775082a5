"""Writing of every report of a run record, and the lines that say where they are."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from ..core.exhaustion import exhausted
from ..core.text import one_line
from ..record.condensed import condensed
from ..record.reader import RecordError, open_record
from . import Run, whole
from .baseline import Baseline

__all__ = ["NAMES", "clear", "reason", "render", "write_all"]

_MARKUP = {"ok": {"green": True, "bold": True}, "bad": {"red": True, "bold": True}, "head": {"bold": True}, "plain": {}}

_WRITERS: Mapping[str, tuple[str, str]] = {
    "report.html": ("html", "write_html"),
    "summary.md": ("markdown", "write_markdown"),
    "verdict.json": ("verdict_file", "write_verdict"),
    "tables": ("latex", "write_tables"),
    "figures": ("figures", "write_figures"),
}
"""Name of a report in the report directory, to the module of this package and its function ``(run, path) -> None``; that of the verdict takes
a baseline as well.

Each module is imported when its report is written: a library that is missing or broken only prevents the reports that need
it.
"""

NAMES = tuple(_WRITERS)
"""Files and folders that :func:`write_all` writes, by their names in the report directory."""

_OF_WHOLE_RUNS = ("tables", "figures")
"""Reports that compare items: a run of a few items does without, and whoever tries one item does not wait for them."""


def write_all(
    run: Run, directory: Path, names: Collection[str] = NAMES, baseline: Baseline | None = None
) -> dict[str, Exception]:
    """Write every report of a run below ``directory``.

    A report that cannot be written does not prevent the others from being written. A report of that name from an earlier run
    is removed, because it is about another run.

    Args:
        run: a run record, as :func:`pytest_otmcp.record.load` returns it.
        directory: the report directory; it is made when it is not there.
        names: those to write; the others are removed.
        baseline: an earlier run; the verdict for a program says what has changed since.

    Returns:
        The names of the reports that could not be written, each with its error; empty when all were written.

    Raises:
        OSError: ``directory`` cannot be made.
    """
    directory.mkdir(parents=True, exist_ok=True)
    failed: dict[str, Exception] = {}
    for name, (module, function) in _WRITERS.items():
        path = directory / name
        if name not in names:
            _remove(path)
            continue
        try:
            _unlink(path)
            compared = (baseline,) if name == "verdict.json" else ()
            getattr(import_module(f".{module}", __package__), function)(run, path, *compared)
        except Exception as error:
            # A record may have any content, and the other reports are still wanted.
            failed[name] = error
            _remove(path)
    return failed


def clear(directory: Path) -> None:
    """Remove record and reports of an earlier run: a run that ends before its first item would leave them as if they were its own."""
    for name in ("run.json", *NAMES):
        _remove(directory / name)


def reason(error: Exception) -> str:
    """Say why a report was not written."""
    if (cure := exhausted(error)) is not None:
        return cure
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return f"{type(error).__name__}: {error}"


def _unlink(path: Path) -> None:
    """Remove a report of that name, or the files of one that is a folder, so that nothing is written through a link."""
    if path.is_dir() and not path.is_symlink():
        for file in path.iterdir():
            if file.is_symlink() or not file.is_dir():
                file.unlink()
    else:
        path.unlink(missing_ok=True)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def render(path: Path, terminal: Any, root: Path, baseline: Baseline | None) -> None:
    """Write every report beside the record ``path``, and the summary to pytest's terminal."""
    try:
        with open_record(path, allow_incomplete=True) as stored:
            run = condensed(stored)
    except RecordError as error:
        terminal.write_line(one_line(f"no reports were written: {error}"), red=True)
        return
    from .console import summary
    from .console_lines import wrapped

    names = NAMES if whole(run) else [name for name in NAMES if name not in _OF_WHOLE_RUNS]
    try:
        failed = write_all(run, path.parent, names, baseline)
    except OSError as error:
        failed = dict.fromkeys(names, error)
    verbosity, width = terminal.config.option.verbose, terminal._tw.fullwidth
    lines = summary(run, width, verbosity=verbosity, fold_verdict=terminal.isatty, baseline=baseline)
    for line, style in lines:
        terminal.write_line(line, **_MARKUP[style])
    for name, why in failed.items():
        terminal.write_line(one_line(f"{name} was not written: {reason(why)}"), red=True)
    if verbosity < -1:
        return
    where = path.parent.relative_to(root) if path.is_relative_to(root) else path.parent
    *first, last = (name for name in ("run.json", *names) if name not in failed)
    texts = [f"{', '.join(first)} and {last} are in {where}" if first else f"{last} is in {where}"]
    if names != NAMES:
        texts.append(
            f"tables and figures are skipped for partial runs; to make them anyway: otmcp report {where / path.name}"
        )
    for text in texts:
        for line in wrapped(text, width, "  "):
            terminal.write_line(line)
