"""Figures over samples. Pure, and without a numerical library: importing one takes longer than a run of one item.

No sample is ever left out. A figure for which there are too few samples is None, never NaN. Sources:

- percentiles: type 7 of Hyndman and Fan, "Sample Quantiles in Statistical Packages", The American Statistician 50 (1996):
  linear interpolation between order statistics, the default of NumPy;
- interval of a mean: Student's t with n - 1 degrees of freedom;
- interval of a proportion: the exact one of Clopper and Pearson, Biometrika 26 (1934);
- interval of a median: order statistics, for any distribution (David and Nagaraja, Order Statistics, section 7.1);
- outliers: Tukey's fences, 1.5 times the interquartile range beyond the quartiles;
- the quantiles behind these intervals: bisection of the regularised incomplete beta function, by its continued fraction (NIST
  Digital Library of Mathematical Functions, 8.17.22).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

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

_TINY, _EPSILON = 1e-300, 1e-15
_TERMS = 10_000
"""Of the continued fraction at most; it needs as many as the root of the larger parameter, and a record may have any counts."""


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
    half = _student_quantile(len(samples) - 1, (1 - confidence) / 2) * deviation / math.sqrt(len(samples))
    return centre - half, centre + half


def median_interval(samples: Sequence[float], confidence: float = 0.95) -> tuple[float, float] | None:
    """Return the narrowest pair of symmetric order statistics that covers the median with at least ``confidence``.

    Of thirty samples these are the 10th and the 21st, which cover it with 95.7 %. The result is None where even smallest
    and largest do not suffice: for fewer than six samples at 95 %.
    """
    count = len(samples)
    if count == 0:
        return None
    # The r-th and the (n + 1 - r)-th miss the median with probability 2 P(X <= r - 1), X binomial with n and 1/2.
    rank, below = 0, 0.0
    for successes in range(count):
        below += math.exp(_log_choose(count, successes) - count * math.log(2))
        if below > (1 - confidence) / 2:
            break
        rank += 1
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
        # The beta quantile in closed form.
        return float(tail ** (1 / total))
    return _where(lambda rate: _beta(rate, good, total - good + 1), tail)


def _student_quantile(freedom: int, tail: float) -> float:
    """Return what Student's t with so many degrees of freedom exceeds with probability ``tail``, which is below one half."""
    share = _where(lambda x: _beta(x, freedom / 2, 0.5), 2 * tail)
    return math.sqrt(freedom * (1 - share) / share)


def _where(increasing: Callable[[float], float], wanted: float) -> float:
    """Return the number from 0 to 1 at which an increasing function has the wanted value, as exactly as a double can say it."""
    low, high = 0.0, 1.0
    while low < (middle := (low + high) / 2) < high:
        if increasing(middle) < wanted:
            low = middle
        else:
            high = middle
    return high


def _beta(x: float, a: float, b: float) -> float:
    """Return the regularised incomplete beta function I(x; a, b) for x from 0 to 1."""
    if x in (0, 1):
        return float(x)
    if x > (a + 1) / (a + b + 2):
        # The fraction converges fast on the other side only.
        return 1 - _beta(1 - x, b, a)
    front = math.exp(a * math.log(x) + b * math.log1p(-x) + math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)) / a
    # Lentz's method; 0 is replaced by a number that changes nothing.
    numerator, denominator = 1.0, 1 / (1 - (a + b) * x / (a + 1) or _TINY)
    value = denominator
    for m in range(1, _TERMS):
        for term in (
            m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)),
        ):
            denominator = 1 / (1 + term * denominator or _TINY)
            numerator = 1 + term / numerator or _TINY
            value *= numerator * denominator
        if abs(numerator * denominator - 1) < _EPSILON:
            break
    return front * value


def _log_choose(count: int, chosen: int) -> float:
    return math.lgamma(count + 1) - math.lgamma(chosen + 1) - math.lgamma(count - chosen + 1)
