"""Statistical figures compared with values that are calculated by hand or printed in textbooks."""

from __future__ import annotations

import pytest

from pytest_otmcp.core.statistics import (
    lower_bound,
    mean,
    mean_interval,
    median_interval,
    outliers,
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
    assert mean([]) is None
    assert mean_interval([1.0]) is None
    assert median_interval([]) is None
    assert outliers([1.0]) is None
    assert lower_bound(0, 0) is None
    assert proportion_interval(0, 0) is None


def test_the_t_interval_of_ten_numbers() -> None:
    samples = [float(value) for value in range(1, 11)]
    low, high = mean_interval(samples) or (0, 0)
    # mean 5.5, s = 3.02765, t(0.975, 9) = 2.26216
    assert low == pytest.approx(5.5 - 2.26216 * 3.02765 / 10**0.5, abs=1e-4)
    assert high == pytest.approx(5.5 + 2.26216 * 3.02765 / 10**0.5, abs=1e-4)


def test_thirty_of_thirty_is_not_one_hundred_percent() -> None:
    assert lower_bound(30, 30) == pytest.approx(0.90497, abs=5e-6)
    assert proportion_interval(30, 30) == (pytest.approx(0.884, abs=5e-4), 1.0)
    assert proportion_interval(0, 10) == (0.0, pytest.approx(0.3085, abs=5e-4))


def test_the_bound_for_nine_of_ten() -> None:
    # One-sided Clopper-Pearson: P(X >= 9 | p) = 0.05 at p = 0.6058.
    assert lower_bound(9, 10) == pytest.approx(0.6058, abs=5e-4)
    assert lower_bound(0, 10) == 0.0


@pytest.mark.parametrize(
    ("count", "ranks"), [(6, (1, 6)), (10, (2, 9)), (15, (4, 12)), (20, (6, 15)), (30, (10, 21)), (100, (40, 61))]
)
def test_the_interval_of_the_median_is_the_printed_pair_of_order_statistics(count: int, ranks: tuple[int, int]) -> None:
    # The ranks are those that tables of the sign test's interval give for 95 %.
    assert median_interval([float(count - index) for index in range(count)]) == ranks


def test_five_samples_cannot_cover_the_median_with_95_percent() -> None:
    # The smallest and the largest of five samples miss the median with probability 2 / 2**5 = 6.25 %.
    assert median_interval([1.0, 2.0, 3.0, 4.0, 5.0]) is None
    assert median_interval([1.0, 2.0, 3.0, 4.0, 5.0], confidence=0.9) == (1.0, 5.0)


def test_the_interval_of_the_median_of_many_samples_is_near_its_normal_approximation() -> None:
    count = 100_000
    low, high = median_interval([float(value) for value in range(1, count + 1)]) or (0, 0)
    assert low == pytest.approx(count / 2 - 1.96 * count**0.5 / 2, abs=1.5)
    assert high == count + 1 - low


def test_outliers_are_counted_beyond_tukeys_fences() -> None:
    # Quartiles 2 and 4, fences at -1 and 7: seven is still inside.
    assert outliers([1, 2, 3, 4, 7]) == 0
    assert outliers([1, 2, 3, 4, 7.001]) == 1
    assert outliers([-1.001, 2, 3, 4, 5]) == 1
    assert outliers([2.0] * 10) == 0
