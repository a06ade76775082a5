"""The pictures of the HTML report, as SVG that follows the page's colours. Pure.

The SVG is written here, not by a library, so that letters stay letters and dark pages get dark pictures. The pictures show the
same as the figures, with the same quartiles, whiskers and medians. All texts pass through markupsafe's escaping.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from markupsafe import Markup

from ..core.statistics import percentile
from . import Item, Run, durations, phases
from .families import css_class
from .text import printable

__all__ = ["latencies", "recovery", "strip", "suite_strip"]

_WIDTH, _RIGHT = 720, 70
_ROW, _AXIS = 22, 34
_CELLS = 60
_PHASES = {
    "detect": "detect the outage",
    "restart": "restart of the endpoint",
    "same_session": "answer in the same session",
    "fresh_session": "answer in a fresh session",
}


def strip(item: Item) -> Markup:
    """Draw the repetitions of an item from left to right as at most sixty marks; one bad repetition makes its mark bad."""
    planned = max(item["planned"], len(item["samples"]))
    marks = min(planned, _CELLS)
    # One path for each kind of mark, so that a page with hundreds of items of thirty marks stays small.
    paths = {"good": "", "bad": "", "open": ""}
    for mark in range(marks):
        first, last = mark * planned // marks, (mark + 1) * planned // marks
        own = item["samples"][first:last]
        kind = "open" if len(own) < last - first else "good" if all(sample["ok"] for sample in own) else "bad"
        # A bad mark is lower, not only of another colour.
        paths[kind] += f"M{mark * 4} {'6h3v6' if kind == 'bad' else '1h3v8'}h-3z"
    shapes = Markup().join(Markup('<path class="{}" d="{}"/>').format(*path) for path in paths.items() if path[1])
    good = sum(sample["ok"] for sample in item["samples"])
    return Markup('<svg class="strip" role="img" width="{0}" height="13" viewBox="0 0 {0} 13">{1}{2}</svg>').format(
        4 * marks, Markup("<title>{} of {} repetitions passed</title>").format(good, item["planned"]), shapes
    )


def suite_strip(items: Sequence[Item]) -> Markup:
    """Draw the items of a suite from left to right as marks: low for one that failed, hollow for one that does not apply."""
    paths = {"good": "", "bad": "", "open": ""}
    for index, item in enumerate(items):
        kind = {"PASS": "good", "NOT_APPLICABLE": "open"}.get(item["status"], "bad")
        paths[kind] += f"M{index * 7 + 1} {'6h5v6' if kind == 'bad' else '1h5v8'}h-5z"
    shapes = Markup().join(Markup('<path class="{}" d="{}"/>').format(*path) for path in paths.items() if path[1])
    return Markup(
        '<svg class="strip" aria-hidden="true" width="{0}" height="13" viewBox="0 0 {0} 13">{1}</svg>'
    ).format(7 * len(items), shapes)


class _Scale:
    """A logarithmic axis of milliseconds."""

    def __init__(self, values: Sequence[float], left: int) -> None:
        # No repetition takes less than a microsecond, and a clock that says so must not break the picture.
        found = [max(value, 0.001) for value in values]
        self._low = math.floor(2 * math.log10(min(found))) / 2
        self._high = max(math.ceil(2 * math.log10(max(found))) / 2, self._low + 0.5)
        self.left = left
        self._width = _WIDTH - _RIGHT - left

    def x(self, value: float) -> float:
        share = (math.log10(max(value, 0.001)) - self._low) / (self._high - self._low)
        return round(self.left + share * self._width, 1)

    def axis(self, bottom: int) -> Markup:
        """Draw grid and numbers."""
        marks = Markup()
        for power in range(math.floor(self._low), math.ceil(self._high) + 1):
            for digit in (1, 2, 5):
                value = digit * 10.0**power
                if self._low - 1e-9 <= math.log10(value) <= self._high + 1e-9:
                    at = self.x(value)
                    marks += Markup('<line class="grid" x1="{0}" y1="4" x2="{0}" y2="{1}"/>').format(at, bottom)
                    marks += _text(at, bottom + 14, f"{value:g}", "middle")
        return marks + _text(self.left + self._width / 2, bottom + 29, "milliseconds, logarithmic", "middle")


def _text(x: float, y: float, text: str, anchor: str) -> Markup:
    return Markup('<text x="{}" y="{}" text-anchor="{}">{}</text>').format(round(x, 1), y, anchor, printable(text))


def _picture(title: str, height: int, content: Markup) -> Markup:
    return Markup('<svg class="plot" role="img" viewBox="0 0 {} {}"><title>{}</title>{}</svg>').format(
        _WIDTH, height, title, content
    )


def latencies(run: Run) -> Markup | None:
    """Draw box plots of the normal suite: quartiles, whiskers within 1.5 interquartile ranges, and every outlier."""
    rows = [(item, durations(run, [item])) for item in run["items"] if item["suite"] == "normal"]
    rows = [(item, times) for item, times in rows if times]
    if not rows:
        return None
    scale = _Scale([time for _, times in rows for time in times], left=90)
    bottom = 8 + _ROW * len(rows)
    content = scale.axis(bottom)
    for index, (item, times) in enumerate(rows):
        content += _box(scale, 8 + _ROW * index + _ROW // 2, item, times)
    return _picture("Latency of the normal suite's tasks: box plots", bottom + _AXIS, content)


def _box(scale: _Scale, y: int, item: Item, times: Sequence[float]) -> Markup:
    low, middle, high = (percentile(times, percent) or 0.0 for percent in (25, 50, 75))
    reach = 1.5 * (high - low)
    inside = [time for time in times if low - reach <= time <= high + reach]
    marks = Markup('<line class="ink" x1="{}" y1="{y}" x2="{}" y2="{y}"/>').format(
        scale.x(min(inside)), scale.x(max(inside)), y=y
    )
    marks += Markup('<rect class="box {}" x="{}" y="{}" width="{}" height="12"/>').format(
        css_class(item["family"]), scale.x(low), y - 6, round(max(1.0, scale.x(high) - scale.x(low)), 1)
    )
    marks += Markup('<line class="median" x1="{0}" y1="{1}" x2="{0}" y2="{2}"/>').format(scale.x(middle), y - 7, y + 7)
    for time in times:
        if not low - reach <= time <= high + reach:
            marks += Markup('<circle class="ink" cx="{}" cy="{}" r="1.6"/>').format(scale.x(time), y)
    return marks + _text(scale.left - 8, y + 4, item["id"], "end") + _text(_WIDTH - 4, y + 4, f"{middle:.2f}", "end")


def recovery(run: Run) -> Markup | None:
    """Draw the median of each phase of the recovery items as a dot: a logarithmic axis has no origin for a bar to begin at."""
    items = [item for item in run["items"] if item["suite"] == "recovery"]
    medians = {(item["id"], name): percentile(phases(run, item, name), 50) for item in items for name in _PHASES}
    known = [median for median in medians.values() if median is not None]
    if not known:
        return None
    scale = _Scale([min(known) / 2, *known], left=200)
    bars, y = Markup(), 0
    for item in items:
        bars += Markup('<g class="head">{}</g>').format(_text(4, y + 16, item["family"], "start"))
        y += _ROW
        for name, label in _PHASES.items():
            bars += _text(scale.left - 8, y + 12, label, "end") + _dot(
                scale, y, item["family"], medians[item["id"], name]
            )
            y += 17
    bottom = y + 8
    return _picture("Recovery from an outage: median of each phase", bottom + _AXIS, scale.axis(bottom) + bars)


def _dot(scale: _Scale, y: int, family: str, median: float | None) -> Markup:
    if median is None:
        return _text(scale.left + 6, y + 12, "did not happen", "start")
    dot = Markup(
        '<line class="grid" x1="{0}" y1="{1}" x2="{2}" y2="{1}"/><circle class="{3}" cx="{2}" cy="{1}" r="4.5"/>'
    ).format(scale.left, y + 8, scale.x(median), css_class(family))
    return dot + _text(_WIDTH - 4, y + 12, f"{median:.1f}", "end")
