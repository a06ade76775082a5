"""Interleaved rounds, medians, and the ratios that have a target."""

from __future__ import annotations

import gc
import random
import statistics
from collections.abc import Mapping
from dataclasses import dataclass

from .probes import NAMES, Probe

__all__ = ["ENUMERATION_SERVICES", "Ratio", "measure", "ratios", "table"]

ENUMERATION_SERVICES = 6
"""So many service calls an enumeration may make."""

_ROUNDS, _CALLS = 40, 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Ratio:
    """A ratio of medians of one run.

    Attributes:
        probe: whose ratio it is.
        formula: what is divided by what.
    """

    probe: str
    formula: str
    value: float
    target: float

    @property
    def verdict(self) -> str:
        """In words."""
        return "target met" if self.value <= self.target else "target missed"


def measure(probes: Mapping[str, Probe]) -> dict[str, list[int]]:
    """Nanoseconds of every call of every probe.

    Every round visits all probes in a new order, so that a slow moment of the machine meets all of them, and no probe
    always runs in the wake of the same other one. The first call of each visit is not counted: it finds cold caches.
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
                probe = probes[name]
                probe()
                samples[name] += [probe() for _ in range(_CALLS)]
    finally:
        gc.enable()
    return samples


def ratios(samples: Mapping[str, list[int]]) -> list[Ratio]:
    """The ratios that have a target."""
    median = {name: statistics.median(values) for name, values in samples.items()}
    found = [
        Ratio(
            probe=call,
            formula=f"{call} / (null + {raw})",
            value=median[call] / (median["null"] + median[raw]),
            target=1.15,
        )
        for call, raw in (("M2", "modbus"), ("Q3", "mqtt"), ("O1", "opcua"))
    ]
    found.append(Ratio(probe="O4", formula="O4 / opcua", value=median["O4"] / median["opcua"], target=10.0))
    found.append(Ratio(probe="null", formula="null / stock", value=median["null"] / median["stock"], target=0.65))
    return found


def table(samples: Mapping[str, list[int]], services: list[str]) -> str:
    """Medians, ratios and the service calls of an enumeration, for the terminal."""
    lines = ["", f"{'microseconds':<62}{'median':>8}{'p95':>8}"]
    for name, values in samples.items():
        p95 = statistics.quantiles(values, n=20)[-1]
        lines.append(f"{name:<15}{NAMES[name]:<47}{statistics.median(values) / 1e3:>8.0f}{p95 / 1e3:>8.0f}")
    lines += ["", f"{'ratio of medians':<30}{'measured':>10}{'target':>9}"]
    lines += [
        f"{r.formula:<30}{r.value:>10.2f}{'<= ' + format(r.target, 'g'):>9}  {r.verdict}" for r in ratios(samples)
    ]
    within = "target met" if len(services) <= ENUMERATION_SERVICES else "target missed"
    lines.append(f"{'O4 service calls':<30}{len(services):>10}{f'<= {ENUMERATION_SERVICES}':>9}  {within}")
    return "\n".join(lines)
