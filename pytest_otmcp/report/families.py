"""The families of items in the order of tables and figures, and their colours. Pure.

A family is a protocol of the registry, by its name; the items about several protocols are a family, too. A record may hold
families of protocols that are not installed here: these come last and have no colour of their own.
"""

from __future__ import annotations

from typing import cast

from ..core.matrix import CROSS_PROTOCOL
from ..protocols.protocol import Colour
from ..protocols.registry import protocols
from ..suite.spoken import spoken
from . import Run, applies

__all__ = [
    "apart",
    "applying_families",
    "benchmark",
    "css_class",
    "families",
    "family_colour",
    "spoken_families",
    "style_sheet",
]

_CROSS_COLOUR = Colour(light="#cc79a7", dark="#d98fb8")
_CROSS_CLASS = "cross"


def families(run: Run) -> list[str]:
    """Return the families of a run's items, the known ones first."""
    known = _known()
    found = dict.fromkeys(item["family"] for item in run["items"])
    return [name for name in known if name in found] + [name for name in found if name not in known]


def _known() -> list[str]:
    return [*(protocol.name for protocol in protocols().values()), CROSS_PROTOCOL]


def applying_families(run: Run) -> list[str]:
    """Return the families of which an item applies to the subject; all of them when none does."""
    applying = {item["family"] for item in run["items"] if applies(item)}
    return [name for name in families(run) if name in applying] or families(run)


def spoken_families(run: Run) -> list[str]:
    """Return the families about the protocols that the subject speaks, also those of which no item ran."""
    found = spoken(run)
    return [name for name in dict.fromkeys((*_known(), *found)) if name in found]


def apart(run: Run) -> list[str]:
    """Return the families whose totals stand apart from the benchmark's, in a run that has both.

    The benchmark's tables and totals are those of the paper, whose protocols are part of every run.
    """
    always = {CROSS_PROTOCOL, *(protocol.name for protocol in protocols().values() if protocol.always)}
    applying = applying_families(run)
    further = [name for name in applying if name not in always]
    return further if len(further) < len(applying) else []


def benchmark(run: Run) -> Run:
    """Return a run without the items of the families that stand apart."""
    further = apart(run)
    return cast("Run", {**run, "items": [item for item in run["items"] if item["family"] not in further]})


def family_colour(family: str) -> Colour | None:
    """Return the colour of a family, or None for a family that is not known here."""
    return {CROSS_PROTOCOL: _CROSS_COLOUR, **{known.name: known.colour for known in protocols().values()}}.get(family)


def css_class(family: str) -> str:
    """Return the class that fills shapes with the colour of a family in the report."""
    return next((known.key for known in protocols().values() if known.name == family), _CROSS_CLASS)


def style_sheet() -> str:
    """Return the style sheet with the families' colours and classes, on light and on dark pages."""
    colours = {**{known.key: known.colour for known in protocols().values()}, _CROSS_CLASS: _CROSS_COLOUR}
    light = " ".join(f"--{name}: {colour.light};" for name, colour in colours.items())
    dark = " ".join(f"--{name}: {colour.dark};" for name, colour in colours.items())
    lines = [
        f":root {{ {light} }}",
        f"@media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}",
        *(f".{name} {{ fill: var(--{name}); }}" for name in colours),
    ]
    return "\n".join(lines) + "\n"
