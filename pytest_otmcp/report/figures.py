"""The figures of a run, each as PDF and PNG, sized for one column of a two-column paper.

A colour is a protocol's and means nothing else; what is no protocol is grey. matplotlib is used without pyplot: no global
state, no display. Metadata hold no dates, so the same record gives the same files. A figure for which a run has no data is not
drawn, and its file from an earlier run is removed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from ..core.statistics import percentile
from ..protocols.registry import protocols
from . import Item, Run, adapters, durations, phases, timing_valid
from .families import benchmark, family_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["contrast", "ink_on", "save_figures", "write_figures"]

_WIDTH_IN = 3.5
_STYLE: dict[Any, Any] = {
    "font.size": 7,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "pdf.fonttype": 42,
    "savefig.dpi": 300,
}
_PALE, _DARK = "#ededed", "#4d4d4d"

# Tool counts of the protocol modules that the paper lists beside the three that it evaluates.
_OTHER_PROTOCOLS = {
    "BACnet/IP": 7,
    "DNP3": 8,
    "EtherCAT": 14,
    "EtherNet/IP": 17,
    "PROFIBUS DP/PA": 11,
    "PROFINET": 14,
    "S7comm": 20,
}

_SHOWN_CODES = 8
_PHASES = {
    "detect": "detect",
    "restart": "endpoint restart",
    "same_session": "same session",
    "fresh_session": "fresh session",
}

Draw = Callable[[Run, "Axes"], bool]


def contrast(one: str, other: str) -> float:
    """Return the contrast ratio of two colours, from 1 to 21 (WCAG 2.2, section 1.4.3)."""
    from matplotlib.colors import to_rgb

    def luminance(colour: str) -> float:
        red, green, blue = (
            part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in to_rgb(colour)
        )
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def ink_on(ground: str) -> str:
    """Return black or white, whichever can be read better on a ground; that is always a contrast of 4.5 at least."""
    return max(("black", "white"), key=lambda ink: contrast(ink, ground))


def write_figures(run: Run, directory: Path) -> None:
    """Write every figure of a run below ``directory``; families that stand apart are in the map of protocols alone."""
    run = benchmark(run)
    figures: dict[str, tuple[Draw, float]] = {
        "latency_boxplot": (_latency_boxplot, 2.9),
        "error_classes": (_error_classes, 2.0),
        "recovery_phases": (_recovery_phases, 2.0),
        "protocol_map": (_protocol_map, 2.2),
    }
    save_figures({name: (partial(draw, run), height) for name, (draw, height) in figures.items()}, directory)


def save_figures(figures: Mapping[str, tuple[Callable[[Axes], bool], float]], directory: Path) -> None:
    """Write figures below ``directory``.

    Args:
        figures: name to what draws it, and tells whether there was anything to draw, and its height in inches.
    """
    mpl = _matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    directory.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        for name, (draw, height) in figures.items():
            figure = Figure(figsize=(_WIDTH_IN, height), layout="constrained")
            FigureCanvasAgg(figure)
            drawn = draw(figure.add_subplot())
            for suffix, metadata in ((".pdf", {"CreationDate": None}), (".png", {"Software": None})):
                path = directory / f"{name}{suffix}"
                if drawn:
                    figure.savefig(path, metadata=metadata)
                else:
                    path.unlink(missing_ok=True)


def _matplotlib() -> ModuleType:
    """Import matplotlib with the settings that come with it: it obeys those of the working directory, where an adapter may have put some."""
    found = find_spec("matplotlib")
    assert found is not None
    assert found.origin is not None
    # The working directory may be one that is not there any more.
    here = os.open(".", os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.chdir(Path(found.origin).parent / "mpl-data")
        return import_module("matplotlib")
    finally:
        os.fchdir(here)
        os.close(here)


def _items(run: Run, suite: str) -> list[Item]:
    return [item for item in run["items"] if item["suite"] == suite and item["samples"]]


def _latency_boxplot(run: Run, axes: Axes) -> bool:
    items = _items(run, "normal")
    if not items or not timing_valid(run):
        return False
    boxes = axes.boxplot(
        [durations(run, [item]) for item in items],
        orientation="horizontal",
        patch_artist=True,
        widths=0.6,
        medianprops={"color": "black", "linewidth": 0.9},
        whiskerprops={"linewidth": 0.6},
        capprops={"linewidth": 0.6},
        boxprops={"linewidth": 0.5},
        flierprops={"marker": ".", "markersize": 2.5, "markerfacecolor": "0.3", "markeredgecolor": "none"},
    )
    for box, item in zip(boxes["boxes"], items, strict=True):
        box.set_facecolor(_colour(item["family"]))
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:.0e}"[0] in "25" else "")
    # Marks of minor ticks are shorter by 1.5 points: with that distance the numbers of both stand on one line.
    axes.tick_params(axis="x", which="minor", pad=5)
    axes.set_yticks(range(1, len(items) + 1), [_label(item["id"]) for item in items])
    axes.tick_params(axis="y", length=0, labelsize=6)
    axes.set_xlabel("tool-call latency (ms), logarithmic")
    axes.grid(axis="x", which="both", linewidth=0.3, color="0.88")
    axes.set_axisbelow(True)
    axes.invert_yaxis()
    _separate(axes, [item["family"] for item in items], first=1)
    families = dict.fromkeys(item["family"] for item in items)
    _legend(axes, [(family, _colour(family)) for family in families])
    return True


def _separate(axes: Axes, families: Sequence[str], first: int = 0) -> None:
    """Draw a line between the rows of two families."""
    for index in range(1, len(families)):
        if families[index] != families[index - 1]:
            axes.axhline(first + index - 0.5, linewidth=0.5, color="0.6")


def _legend(axes: Axes, entries: list[tuple[str, str]]) -> None:
    from matplotlib.patches import Patch

    axes.legend(
        handles=[Patch(facecolor=colour, label=_label(label)) for label, colour in entries],
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        ncols=min(4, len(entries)),
        frameon=False,
        fontsize=6,
        handlelength=1.0,
        handletextpad=0.4,
        columnspacing=1.0,
    )


def _colour(family: str, unknown: str = "0.6") -> str:
    found = family_colour(family)
    return unknown if found is None else found.light


def _label(text: str) -> str:
    """Make a text safe for matplotlib: no mathematics, and only letters that its fonts have. Adapters invent codes, and records ids."""
    return ascii(text[:40])[1:-1][:40].replace("_", " ").replace("$", r"\$")


def _error_classes(run: Run, axes: Axes) -> bool:
    """Draw how many runs of each item had an error code, as a heat map: code by item."""
    items = _items(run, "fault")
    counts: dict[str, list[int]] = {}
    for index, item in enumerate(items):
        for sample in item["samples"]:
            for code in {
                call["error_code"] for call in sample["calls"] if call["role"] == "task" and call["error_code"]
            }:
                counts.setdefault(code, [0] * len(items))[index] += 1
    if not counts:
        return False
    # In the order of the items that have them, so that the usual run is a diagonal.
    codes = sorted(counts, key=lambda code: (-sum(counts[code]), code))[:_SHOWN_CODES]
    codes.sort(key=lambda code: next(index for index, count in enumerate(counts[code]) if count))
    rows = {_label(code): counts.pop(code) for code in codes}
    if counts:
        rows["other codes"] = [sum(column) for column in zip(*counts.values(), strict=True)]
    for row, values in enumerate(rows.values()):
        for column, value in enumerate(values):
            share = value / len(items[column]["samples"])
            # Grey, because a colour is a protocol's; never so dark that the grid of cells cannot be seen.
            ground = str(round(1 - 0.75 * min(1.0, share), 3))
            axes.add_patch(_cell(column, row, ground))
            if value:
                axes.text(column, row, str(value), ha="center", va="center", fontsize=6, color=ink_on(ground))
    axes.set_xlim(-0.5, len(items) - 0.5)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xticks(range(len(items)), [_label(item["id"]) for item in items])
    axes.set_yticks(range(len(rows)), list(rows))
    axes.tick_params(length=0, labelsize=6)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_xlabel("runs with this error code; grey by their share of the item's runs", fontsize=6)
    return True


def _cell(column: int, row: int, ground: str) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle((column - 0.5, row - 0.5), 1, 1, facecolor=ground, edgecolor="0.8", linewidth=0.5)


def _recovery_phases(run: Run, axes: Axes) -> bool:
    """Draw the median of each phase as a dot: a logarithmic axis has no origin for a bar to begin at."""
    items = _items(run, "recovery")
    if not items or not timing_valid(run):
        return False
    rows = [(item, phase) for item in items for phase in _PHASES]
    medians = [percentile(phases(run, item, phase), 50) for item, phase in rows]
    for row, ((item, _), median) in enumerate(zip(rows, medians, strict=True)):
        if median is not None:
            axes.plot([median], [row], "o", markersize=4, color=_colour(item["family"]))
            axes.annotate(f"{median:.1f}", (median, row), (4, 0), textcoords="offset points", va="center", fontsize=5.5)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlim(right=axes.get_xlim()[1] * 2)
    axes.set_yticks(range(len(rows)), [_PHASES[phase] for _, phase in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0, labelsize=6)
    axes.grid(axis="both", linewidth=0.3, color="0.88")
    axes.set_axisbelow(True)
    _separate(axes, [item["family"] for item, _ in rows])
    axes.set_xlabel("median (ms), logarithmic")
    _legend(axes, [(item["family"], _colour(item["family"])) for item in items])
    return True


def _protocol_map(run: Run, axes: Axes) -> bool:
    if run["settings"].get("subject"):
        # The map is the paper's: seven of its protocols have nothing to do with a vendor's run.
        return False
    sessions = adapters(run)
    boxes = [(known.name, sessions[key].get("tools"), True) for key, known in protocols().items() if key in sessions]
    if not boxes:
        return False
    # The paper's names are longer than ours: PROFIBUS DP/PA.
    evaluated = [known.recognise for key, known in protocols().items() if key in sessions]
    boxes += [
        (name, tools, False)
        for name, tools in _OTHER_PROTOCOLS.items()
        if not any(recognise.search(name) for recognise in evaluated)
    ]
    columns = 3
    for index, (name, tools, tested) in enumerate(boxes):
        row, column = divmod(index, columns)
        colour = _colour(name, unknown=_PALE) if tested else _PALE
        axes.add_patch(_box(column, -row, colour, "black" if tested else "0.6", "solid" if tested else "dashed"))
        ink = ink_on(colour) if tested else _DARK
        axes.text(column + 0.46, -row + 0.5, name, ha="center", va="center", fontweight="bold", color=ink)
        note = f"{tools} tools, evaluated" if tested else f"{tools} tools in the paper"
        axes.text(column + 0.46, -row + 0.22, note, ha="center", va="center", fontsize=5.5, color=ink)
    rows = -(-len(boxes) // columns)
    axes.set_xlim(-0.05, columns)
    axes.set_ylim(1.05 - rows, 0.85)
    axes.set_axis_off()
    return True


def _box(column: float, row: float, face: str, edge: str, line: str) -> Any:
    from matplotlib.patches import FancyBboxPatch

    return FancyBboxPatch(
        (column + 0.04, row + 0.09),
        0.84,
        0.58,
        boxstyle="round,pad=0.02,rounding_size=0.06",
        facecolor=face,
        edgecolor=edge,
        linestyle=line,
        linewidth=0.6,
    )
