"""Runs side by side: what may be connected, which items pass, which rules are broken, and where they differ. Pure.

The runs are of several adapters, or of several versions of one; a run is a column, in the order in which they were given.
Latencies are not compared: runs of different days measure the machine, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..suite.spoken import spoken, tell
from . import Item, Run, control_failed, tally
from .capabilities import Grade, earned
from .causes import causes
from .families import applying_families, families
from .identity import identity
from .overview import requirements

__all__ = ["Cell", "Column", "Comparison", "Row", "compared"]

_NOT_APPLICABLE, _NOT_RUN = "n/a", "did not run"
_NOT_JUDGED = (_NOT_APPLICABLE, _NOT_RUN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """What one run says of a row; ``tone``: ``good``, ``bad`` or ``open``."""

    text: str
    tone: str
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A row of a matrix with a cell for each run.

    Attributes:
        changed: the runs do not agree.
    """

    name: str
    about: str
    cells: tuple[Cell, ...]

    @property
    def changed(self) -> bool:
        return len({(cell.text, cell.tone) for cell in self.cells}) > 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A run: its subject, its verdict, and the facts that identify it."""

    name: str
    verdict: Cell
    items: str
    passed: str
    identity: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Several runs side by side.

    Attributes:
        notes: sentences on why the runs cannot be compared in everything.
    """

    columns: tuple[Column, ...]
    capabilities: tuple[Row, ...]
    items: tuple[Row, ...]
    rules: tuple[Row, ...]
    notes: tuple[str, ...]

    @property
    def changes(self) -> list[str]:
        """Say of each item that all runs have judged and do not agree on how it went, in the order of the runs."""
        return [
            f"{row.name} {', '.join(cell.text for cell in row.cells)}"
            for row in self.items
            if row.changed and not any(cell.text in _NOT_JUDGED for cell in row.cells)
        ]

    @property
    def partial(self) -> int:
        """Count the items that only some of the runs have judged."""
        judged = ([cell.text in _NOT_JUDGED for cell in row.cells] for row in self.items)
        return sum(any(row) and not all(row) for row in judged)


def compared(runs: Sequence[Run]) -> Comparison:
    """Compare runs; there are at least two."""
    columns = [_column(run, name) for run, name in zip(runs, _names(runs), strict=True)]
    return Comparison(
        columns=tuple(columns),
        capabilities=tuple(_capabilities(runs)),
        items=tuple(_items(runs)),
        rules=tuple(_rules(runs)),
        notes=tuple(_notes(runs, columns)),
    )


def _names(runs: Sequence[Run]) -> list[str]:
    """Return what the runs are called: name and version, and a number where that is not enough to tell them apart."""
    names = [f"{run['subject'].get('name')} {run['subject'].get('version')}" for run in runs]
    return [
        f"{name} (run {names[:index].count(name) + 1})" if names.count(name) > 1 else name
        for index, name in enumerate(names)
    ]


def _column(run: Run, name: str) -> Column:
    verdict = run["footer"].get("verdict", "INCOMPLETE")
    good, planned = tally(run["items"])
    return Column(
        name=name,
        verdict=Cell(text=verdict, tone={"CONFORMANT": "good", "NOT CONFORMANT": "bad"}.get(verdict, "open")),
        items=tell(spoken(run)),
        passed=f"{good}/{planned}",
        identity=tuple(identity(run)),
    )


def _in_any(runs: Sequence[Run], names: Callable[[Run], list[str]]) -> list[str]:
    """Return the names of all runs, each once, in the order of the runs that have them."""
    return list(dict.fromkeys(name for run in runs for name in names(run)))


def _capabilities(runs: Sequence[Run]) -> list[Row]:
    grades = [{heading.name: by_family for heading, by_family in earned(run)} for run in runs]
    applying = [set(applying_families(run)) for run in runs]
    explained: set[str] = set()
    rows = []
    for family in _in_any(runs, families):
        for heading, _ in earned(runs[0]):
            cells = []
            for own, known in zip(grades, applying, strict=True):
                one = own.get(heading.name, {}).get(family)
                grade = Grade.NOT_CLAIMED if one is None or family not in known else one.grade
                tone = {Grade.EARNED: "good", Grade.NOT_EARNED: "bad"}.get(grade, "open")
                because = " ".join(one.because) if one is not None and grade is Grade.NOT_EARNED else ""
                cells.append(Cell(text=grade.value, tone=tone, note=because))
            if any(cell.text not in (Grade.NOT_CLAIMED, Grade.NOT_TESTED) for cell in cells):
                # What a capability means is said once, not with every protocol again.
                about = "" if heading.name in explained else heading.meaning
                explained.add(heading.name)
                rows.append(Row(name=f"{family}: {heading.name}", about=about, cells=tuple(cells)))
    return rows


def _items(runs: Sequence[Run]) -> list[Row]:
    found = [{item["id"]: item for item in run["items"]} for run in runs]
    rows = []
    for name in _in_any(runs, lambda run: [item["id"] for item in run["items"]]):
        title = next(items[name]["title"] for items in found if name in items)
        cells = tuple(_item(items.get(name)) for items in found)
        if any(cell.text != _NOT_APPLICABLE for cell in cells):
            rows.append(Row(name=name, about=title, cells=cells))
    return rows


def _item(item: Item | None) -> Cell:
    if item is None:
        return Cell(text=_NOT_RUN, tone="open")
    if item["status"] == "NOT_APPLICABLE":
        return Cell(text=_NOT_APPLICABLE, tone="open")
    good, planned = tally([item])
    passed = f"{good}/{planned}" + (", failed beside the repetitions" if control_failed(item, good) else "")
    tone = {"PASS": "good", "KIT_ERROR": "open", "INTERRUPTED": "open"}.get(item["status"], "bad")
    return Cell(text=item["status"], tone=tone, note=passed)


def _rules(runs: Sequence[Run]) -> list[Row]:
    found = [{(one.family, one.rule): one for one in causes(run)} for run in runs]
    known = [dict(requirements(run)) for run in runs]
    rows = []
    for family, rule in dict.fromkeys(place for own in found for place in own):
        cells = []
        for own, states in zip(found, known, strict=True):
            if (cause := own.get((family, rule))) is not None:
                cells.append(Cell(text="violated", tone="bad", note=" ".join(cause.items)))
            else:
                cell = states.get(rule, {}).get(family)
                state = "not asked" if cell is None else cell.state
                cells.append(Cell(text=state, tone="good" if state == "kept" else "open"))
        about = next(own[family, rule].statement for own in found if (family, rule) in own)
        rows.append(Row(name=f"{family}: {rule}", about=about, cells=tuple(cells)))
    return rows


def _notes(runs: Sequence[Run], columns: Sequence[Column]) -> list[str]:
    notes = []
    if len({run["kit"].get("suite_digest") for run in runs}) > 1:
        notes.append("The runs are of different suites: an item may ask for more in one than in the other.")
    reps = [run["settings"].get("reps") for run in runs]
    if len(set(reps)) > 1:
        notes.append(f"The repetitions differ (N = {', '.join(map(str, reps))}): more of them find what is rare.")
    for run, column in zip(runs, columns, strict=True):
        if not run["footer"]["complete"]:
            notes.append(f"The run of {column.name} is not complete: {run['footer'].get('reason')}.")
    return notes
