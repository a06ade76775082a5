"""Figures against values worked out by hand or printed in textbooks."""

from __future__ import annotations

import pytest

from pytest_otmcp.statistics import (
    lower_bound,
    mean_interval,
    percentile,
    proportion_interval,
    standard_deviation,
)


def test_percentiles_interpolate_between_order_statistics() -> None:
    assert percentile([4, 1, 3, 2], 50) == 2.5
    assert percentile([1, 2, 3, 4, 5], 95) == pytest.approx(4.8)
    assert percentile([7], 95) == 7


def test_no_samples_have_no_figures() -> None:
    assert percentile([], 50) is None
    assert standard_deviation([1.0]) is None
    assert mean_interval([1.0]) is None
    assert lower_bound(0, 0) is None
    assert proportion_interval(0, 0) is None


def test_the_t_interval_of_ten_numbers() -> None:
    samples = [float(value) for value in range(1, 11)]
    low, high = mean_interval(samples) or (0, 0)
    # mean 5.5, s = 3.02765, t(0.975, 9) = 2.26216
    assert low == pytest.approx(5.5 - 2.26216 * 3.02765 / 10**0.5, abs=1e-4)
    assert high == pytest.approx(5.5 + 2.26216 * 3.02765 / 10**0.5, abs=1e-4)


def test_thirty_of_thirty_is_not_one_hundred_percent() -> None:
    assert lower_bound(30, 30) == pytest.approx(0.905, abs=5e-4)
    assert proportion_interval(30, 30) == (pytest.approx(0.884, abs=5e-4), 1.0)
    assert proportion_interval(0, 10) == (0.0, pytest.approx(0.3085, abs=5e-4))


def test_the_bound_for_nine_of_ten() -> None:
    # One-sided Clopper-Pearson: P(X >= 9 | p) = 0.05 at p = 0.6058.
    assert lower_bound(9, 10) == pytest.approx(0.6058, abs=5e-4)
    assert lower_bound(0, 10) == 0.0
