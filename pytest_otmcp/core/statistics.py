"""Figures over samples. Pure; scipy is imported only when an interval is asked for.

No sample is ever left out. A figure for which there are too few samples is None, never NaN. Sources:

- percentiles: type 7 of Hyndman and Fan, "Sample Quantiles in Statistical Packages", The American Statistician 50 (1996):
  linear interpolation between order statistics, the default of NumPy;
- interval of a mean: Student's t with n - 1 degrees of freedom;
- interval of a proportion: the exact one of Clopper and Pearson, Biometrika 26 (1934);
- interval of a median: order statistics, for any distribution (David and Nagaraja, Order Statistics, section 7.1);
- outliers: Tukey's fences, 1.5 times the interquartile range beyond the quartiles.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

__all__ = [
    "lower_bound",
    "mean",
    "mean_interval",
    "median_interval",
    "outliers",
    "percentile",
    "proportion_interval",
    "standard_deviation",
]


def percentile(samples: Sequence[float], percent: float) -> float | None:
    """Return the percentile, 0 to 100; None without samples."""
    if not samples:
        return None
    ordered = sorted(samples)
    position = (len(ordered) - 1) * percent / 100
    below = math.floor(position)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (ordered[above] - ordered[below]) * (position - below)


def mean(samples: Sequence[float]) -> float | None:
    """Return the arithmetic mean; None without samples."""
    return math.fsum(samples) / len(samples) if samples else None


def standard_deviation(samples: Sequence[float]) -> float | None:
    """Return the sample standard deviation (n - 1); None for fewer than two samples."""
    centre = mean(samples)
    if centre is None or len(samples) < 2:
        return None
    return math.sqrt(math.fsum((sample - centre) ** 2 for sample in samples) / (len(samples) - 1))


def mean_interval(samples: Sequence[float], confidence: float = 0.95) -> tuple[float, float] | None:
    """Return the t interval of the mean; None for fewer than two samples."""
    deviation = standard_deviation(samples)
    centre = mean(samples)
    if deviation is None or centre is None:
        return None
    # scipy.stats.t.ppf is this very function, but importing scipy.stats takes three times as long.
    from scipy.special import stdtrit

    half = float(stdtrit(len(samples) - 1, (1 + confidence) / 2)) * deviation / math.sqrt(len(samples))
    return centre - half, centre + half


def median_interval(samples: Sequence[float], confidence: float = 0.95) -> tuple[float, float] | None:
    """Return the narrowest pair of symmetric order statistics that covers the median with at least ``confidence``.

    Of thirty samples these are the 10th and the 21st, which cover it with 95.7 %. The result is None where even smallest
    and largest do not suffice: for fewer than six samples at 95 %.
    """
    count = len(samples)
    if count == 0:
        return None
    from scipy.special import bdtr

    # The r-th and the (n + 1 - r)-th miss the median with probability 2 P(X <= r - 1), X binomial with n and 1/2.
    tail = (1 - confidence) / 2
    rank = bisect_right(range(count), tail, key=lambda below: float(bdtr(below, count, 0.5)))
    if rank == 0:
        return None
    ordered = sorted(samples)
    return ordered[rank - 1], ordered[count - rank]


def outliers(samples: Sequence[float]) -> int | None:
    """Count the samples outside Tukey's fences; None for fewer than two samples."""
    low, high = percentile(samples, 25), percentile(samples, 75)
    if low is None or high is None or len(samples) < 2:
        return None
    reach = 1.5 * (high - low)
    return sum(not low - reach <= sample <= high + reach for sample in samples)


def proportion_interval(good: int, total: int, confidence: float = 0.95) -> tuple[float, float] | None:
    """Return the two-sided Clopper-Pearson interval of ``good`` out of ``total``; None for a total of 0."""
    if total == 0:
        return None
    tail = (1 - confidence) / 2
    return _clopper_pearson_low(good, total, tail), 1.0 - _clopper_pearson_low(total - good, total, tail)


def lower_bound(good: int, total: int, confidence: float = 0.95) -> float | None:
    """Return the one-sided Clopper-Pearson lower bound: 30 of 30 is more than 0.904 with 95 % confidence; None for a total
    of 0."""
    return None if total == 0 else _clopper_pearson_low(good, total, 1 - confidence)


def _clopper_pearson_low(good: int, total: int, tail: float) -> float:
    if good == 0:
        return 0.0
    if good == total:
        # The beta quantile in closed form: an item that passes every time needs no scipy.
        return float(tail ** (1 / total))
    from scipy.special import betaincinv

    return float(betaincinv(good, total - good + 1, tail))
