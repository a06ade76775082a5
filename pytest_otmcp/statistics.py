"""Figures over samples. Pure; scipy is imported only when an interval is asked for.

Definitions: percentiles are type 7 of Hyndman and Fan (linear interpolation between order statistics, the default of
NumPy); the interval of a mean is Student's t with n - 1 degrees of freedom; the interval of a proportion is the exact
one of Clopper and Pearson. No sample is ever left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

__all__ = ["lower_bound", "mean", "mean_interval", "percentile", "proportion_interval", "standard_deviation"]


def percentile(samples: Sequence[float], percent: float) -> float | None:
    """The percentile, 0 to 100; None without samples."""
    if not samples:
        return None
    ordered = sorted(samples)
    position = (len(ordered) - 1) * percent / 100
    below = math.floor(position)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (ordered[above] - ordered[below]) * (position - below)


def mean(samples: Sequence[float]) -> float | None:
    """The arithmetic mean; None without samples."""
    return math.fsum(samples) / len(samples) if samples else None


def standard_deviation(samples: Sequence[float]) -> float | None:
    """The sample standard deviation (n - 1); None for fewer than two samples."""
    centre = mean(samples)
    if centre is None or len(samples) < 2:
        return None
    return math.sqrt(math.fsum((sample - centre) ** 2 for sample in samples) / (len(samples) - 1))


def mean_interval(samples: Sequence[float], confidence: float = 0.95) -> tuple[float, float] | None:
    """The t interval of the mean; None for fewer than two samples."""
    deviation = standard_deviation(samples)
    centre = mean(samples)
    if deviation is None or centre is None:
        return None
    from scipy.stats import t

    half = float(t.ppf((1 + confidence) / 2, len(samples) - 1)) * deviation / math.sqrt(len(samples))
    return centre - half, centre + half


def proportion_interval(good: int, total: int, confidence: float = 0.95) -> tuple[float, float] | None:
    """The two-sided Clopper-Pearson interval of ``good`` out of ``total``; None for a total of 0."""
    if total == 0:
        return None
    from scipy.stats import beta

    tail = (1 - confidence) / 2
    low = 0.0 if good == 0 else float(beta.ppf(tail, good, total - good + 1))
    high = 1.0 if good == total else float(beta.ppf(1 - tail, good + 1, total - good))
    return low, high


def lower_bound(good: int, total: int, confidence: float = 0.95) -> float | None:
    """The one-sided Clopper-Pearson lower bound: 30 of 30 is at least 0.905 with 95 % confidence."""
    if total == 0:
        return None
    if good == 0:
        return 0.0
    if good == total:
        return float((1 - confidence) ** (1 / total))
    from scipy.stats import beta

    return float(beta.ppf(1 - confidence, good, total - good + 1))
