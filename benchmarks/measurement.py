"""The measurement in interleaved rounds, the medians, and the ratios that have a target."""

from __future__ import annotations

import gc
import random
import statistics
import time
from collections.abc import Mapping
from dataclasses import dataclass

from .families import FAMILIES
from .probes import NAMES, Probe

__all__ = ["ENUMERATION_SERVICES", "Ratio", "measure", "ratios", "table"]

ENUMERATION_SERVICES = 6
"""The largest number of service calls that an enumeration may make."""

_ROUNDS = 480
_PAUSE_S = 0.001
"""The pause before each call, so that no process is still busy with the previous call."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ratio:
    """A ratio of medians of one run.

    Attributes:
        probe: the probe whose ratio it is.
        formula: what is divided by what.
        target: what it should not exceed; None for a control, whose ratio is 1 if costs add up.
    """

    probe: str
    formula: str
    value: float
    target: float | None

    @property
    def verdict(self) -> str:
        """The comparison with the target, in words."""
        if self.target is None:
            return "control"
        return "target met" if self.value <= self.target else "target missed"


def measure(probes: Mapping[str, Probe]) -> dict[str, list[int]]:
    """Measure the nanoseconds of every call of every probe.

    Every round makes one call of each probe, in a new order and after the same pause. So every call finds the machine as
    the other calls have left it: the processes have slept, and the caches hold the data of others. A tool is called in
    such a situation, and only in it do costs add up: a probe that is called over and over in a batch is several times
    faster, and a small program gains more than a large one.
    """
    order = list(probes)
    shuffle = random.Random(1).shuffle
    samples: dict[str, list[int]] = {name: [] for name in probes}
    gc.collect()
    gc.disable()
    try:
        for _ in range(_ROUNDS):
            shuffle(order)
            for name in order:
                time.sleep(_PAUSE_S)
                samples[name].append(probes[name]())
    finally:
        gc.enable()
    return samples


def ratios(samples: Mapping[str, list[int]]) -> list[Ratio]:
    """Return the ratios that have a target, and their controls."""
    median = {name: statistics.median(values) for name, values in samples.items()}

    def exchange(name: str) -> float:
        # The difference is what the exchange adds to the answer of a program that does nothing else.
        return median[name] - median["floor"]

    found = []
    for family in FAMILIES:
        both = median["null"] + exchange(family.key)
        for probe, target in ((family.item, family.target), (f"null+{family.key}", None)):
            formula = f"{probe} / (null + {family.key} - floor)"
            found.append(Ratio(probe=probe, formula=formula, value=median[probe] / both, target=target))
    o4 = median["O4"] / exchange("opcua")
    found.append(Ratio(probe="O4", formula="O4 / (opcua - floor)", value=o4, target=10.0))
    found.append(Ratio(probe="null", formula="null / stock", value=median["null"] / median["stock"], target=0.65))
    return found


def table(samples: Mapping[str, list[int]], services: list[str]) -> str:
    """Format the medians, the ratios and the service calls of an enumeration for the terminal."""
    lines = ["", f"{'microseconds':<66}{'median':>8}{'p95':>8}"]
    for name, values in samples.items():
        p95 = statistics.quantiles(values, n=20)[-1]
        lines.append(f"{name:<17}{NAMES[name]:<49}{statistics.median(values) / 1e3:>8.0f}{p95 / 1e3:>8.0f}")
    lines += ["", f"{'ratio of medians':<48}{'measured':>9}{'target':>9}"]
    for ratio in ratios(samples):
        limit = "" if ratio.target is None else f"<= {ratio.target:g}"
        lines.append(f"{ratio.formula:<48}{ratio.value:>9.2f}{limit:>9}  {ratio.verdict}")
    within = "target met" if len(services) <= ENUMERATION_SERVICES else "target missed"
    lines.append(f"{'O4 service calls':<48}{len(services):>9}{f'<= {ENUMERATION_SERVICES}':>9}  {within}")
    return "\n".join(lines)
