"""The figures of a run, each as PDF and PNG, sized for one column of a two-column paper.

matplotlib is used without pyplot: no global state, no display. Metadata hold no dates, so the same record gives the same
files. A figure for which a run has no data is not drawn, and its file from an earlier run is removed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.statistics import percentile, proportion_interval
from ..protocols.registry import protocols
from . import Item, Run, adapters, durations, phases, recovered, timing_valid
from .families import family_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["write_figures"]

_WIDTH_IN = 3.5
# Okabe and Ito's palette: distinguishable with every common kind of colour blindness.
_BLUE, _ORANGE, _GREEN, _RED, _PURPLE, _SKY, _YELLOW = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#56B4E9",
    "#F0E442",
)
_STYLE: dict[Any, Any] = {
    "font.size": 7,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "pdf.fonttype": 42,
    "savefig.dpi": 300,
}

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

_SHOWN_CODES = 6

Draw = Callable[[Run, "Axes"], bool]


def write_figures(run: Run, directory: Path) -> None:
    """Write every figure of a run below ``directory``."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figures: dict[str, tuple[Draw, float]] = {
        "latency_boxplot": (_latency_boxplot, 2.6),
        "error_classes": (_error_classes, 2.1),
        "recovery_modes": (_recovery_modes, 1.9),
        "recovery_phases": (_recovery_phases, 1.8),
        "protocol_map": (_protocol_map, 2.2),
    }
    directory.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(_STYLE):
        for name, (draw, height) in figures.items():
            figure = Figure(figsize=(_WIDTH_IN, height), layout="constrained")
            FigureCanvasAgg(figure)
            drawn = draw(run, figure.add_subplot())
            for suffix, metadata in ((".pdf", {"CreationDate": None}), (".png", {"Software": None})):
                path = directory / f"{name}{suffix}"
                if drawn:
                    figure.savefig(path, metadata=metadata)
                else:
                    path.unlink(missing_ok=True)


def _items(run: Run, suite: str) -> list[Item]:
    return [item for item in run["items"] if item["suite"] == suite and item["samples"]]


def _latency_boxplot(run: Run, axes: Axes) -> bool:
    items = _items(run, "normal")
    if not items or not timing_valid(run):
        return False
    times = [durations(run, [item]) for item in items]
    boxes = axes.boxplot(
        times,
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
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if value in (2, 5, 20, 50) else "")
    axes.set_xticks(range(1, len(items) + 1), [item["id"] for item in items])
    axes.tick_params(axis="x", length=0, labelsize=6)
    axes.set_ylabel("tool-call latency (ms)")
    axes.grid(axis="y", which="both", linewidth=0.3, color="0.88")
    axes.set_axisbelow(True)
    families = dict.fromkeys(item["family"] for item in items)
    _legend(axes, [(family, _colour(family)) for family in families])
    return True


def _legend(axes: Axes, entries: list[tuple[str, str]]) -> None:
    from matplotlib.patches import Patch

    axes.legend(
        handles=[Patch(facecolor=colour, label=label) for label, colour in entries],
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
    """Make a text safe for matplotlib: no mathematics, and only letters that its fonts have. Adapters invent codes."""
    return ascii(text)[1:-1].replace("_", " ").replace("$", r"\$")[:40]


def _error_classes(run: Run, axes: Axes) -> bool:
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
    colours = [_BLUE, _ORANGE, _GREEN, _RED, _PURPLE, _SKY, _YELLOW]
    bottom = [0] * len(items)
    entries = []
    frequent = sorted(counts, key=lambda code: (-sum(counts[code]), code))[:_SHOWN_CODES]
    shown = {code: counts.pop(code) for code in sorted(frequent)}
    if counts:
        shown["other codes"] = [sum(column) for column in zip(*counts.values(), strict=True)]
    for index, (code, values) in enumerate(shown.items()):
        colour = colours[index % len(colours)]
        axes.bar(range(len(items)), values, 0.65, bottom=bottom, color=colour)
        bottom = [low + value for low, value in zip(bottom, values, strict=True)]
        entries.append((_label(code), colour))
    axes.set_xticks(range(len(items)), [item["id"] for item in items])
    axes.tick_params(axis="x", length=0)
    axes.set_ylabel("runs with this error code")
    _legend(axes, entries)
    return True


def _recovery_modes(run: Run, axes: Axes) -> bool:
    items = _items(run, "recovery")
    if not items:
        return False
    for offset, (way, colour) in zip((-0.18, 0.18), (("same_session", _BLUE), ("fresh_session", _ORANGE)), strict=True):
        for index, item in enumerate(items):
            good, total = recovered([item], way)
            low, high = proportion_interval(good, total) or (0.0, 1.0)
            rate = 100 * good / total
            error = [[rate - 100 * low], [100 * high - rate]]
            axes.bar(index + offset, rate, 0.32, color=colour)
            axes.errorbar(index + offset, rate, yerr=error, color="black", linewidth=0.7, capsize=2)
            axes.text(index + offset, 4, f"{good}/{total}", ha="center", fontsize=6, color="white")
    axes.set_xticks(range(len(items)), [item["family"] for item in items])
    axes.tick_params(axis="x", length=0)
    axes.set_ylim(0, 105)
    axes.set_ylabel("recovered (%),\n95 % Clopper-Pearson")
    _legend(axes, [("same session", _BLUE), ("fresh session", _ORANGE)])
    return True


def _recovery_phases(run: Run, axes: Axes) -> bool:
    items = _items(run, "recovery")
    if not items or not timing_valid(run):
        return False
    names = {
        "detect": ("detect", _RED),
        "restart": ("endpoint restart", "0.75"),
        "same_session": ("same session", _BLUE),
        "fresh_session": ("fresh session", _ORANGE),
    }
    height = 0.8 / len(names)
    for row, (phase, (_, colour)) in enumerate(names.items()):
        for index, item in enumerate(items):
            median = percentile(phases(run, item, phase), 50)
            if median is None:
                continue
            at = index + (row - 1.5) * height
            axes.barh(at, median, height * 0.9, color=colour)
            axes.text(median * 1.12, at, f"{median:.1f}", va="center", fontsize=5.5)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlim(right=axes.get_xlim()[1] * 2)
    axes.set_yticks(range(len(items)), [item["family"] for item in items])
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("median (ms), logarithmic")
    _legend(axes, list(names.values()))
    return True


def _protocol_map(run: Run, axes: Axes) -> bool:
    sessions = adapters(run)
    evaluated = {protocols()[key].name: facts.get("tools") for key, facts in sessions.items() if key in protocols()}
    if not evaluated:
        return False
    boxes = [(name, tools, True) for name, tools in evaluated.items()]
    boxes += [(name, tools, False) for name, tools in _OTHER_PROTOCOLS.items() if name not in evaluated]
    columns = 3
    for index, (name, tools, tested) in enumerate(boxes):
        row, column = divmod(index, columns)
        colour = _colour(name, unknown="0.93")
        axes.add_patch(_box(column, -row, colour, "black" if tested else "0.6", "solid" if tested else "dashed"))
        ink = "white" if tested else "0.35"
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
