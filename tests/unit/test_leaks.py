"""What is lost with every call is told from what fills up, from what is collected late, and from chance."""

from __future__ import annotations

import os

import pytest
from pytest_otmcp.conformance.requirements.res import _growths, _keeps_growing, _may_grow

from pytest_otmcp.record.schema import Footprint
from pytest_otmcp.session.footprint import command_lines, footprint


def looks(*rss_kib: int) -> list[Footprint]:
    return [Footprint(rss_kib=rss, descriptors=9, threads=2, processes=1) for rss in rss_kib]


def memory(*rss_kib: int) -> list[int]:
    return _growths(looks(*rss_kib), "rss_kib")


LINEAR = [70_000 + 500 * window for window in range(40)]


def test_what_grows_with_every_call_is_a_leak() -> None:
    assert _keeps_growing(memory(*LINEAR), "rss_kib")


@pytest.mark.parametrize(
    "figures",
    [
        pytest.param([70_000] * 3, id="nothing"),
        pytest.param([min(figure, 74_000) for figure in LINEAR], id="a cache that is full"),
        pytest.param([70_000 + 500 * (window % 8) for window in range(40)], id="a collector that comes late"),
        pytest.param([70_000 + 140 * window for window in range(40)], id="what a collector has not looked through yet"),
        pytest.param([90_000 - 20_000 // (window + 1) for window in range(40)], id="a runtime that warms up"),
    ],
)
def test_what_has_a_bound_is_none(figures: list[int]) -> None:
    assert not _keeps_growing(memory(*figures), "rss_kib")


def test_growth_that_grows_less_and_less_fills_something() -> None:
    slower = [70_000]
    for window in range(40):
        slower.append(slower[-1] + 2_000 - 45 * window)
    assert _may_grow(memory(*slower), "rss_kib")
    assert not _keeps_growing(memory(*slower), "rss_kib")


def test_the_figures_of_processes_are_those_of_the_kernel() -> None:
    # Everything that descends from the parent of this process.
    found = footprint(os.getppid())
    assert found["processes"] >= 1
    assert found["threads"] >= 1
    assert "lazy_heap" not in found
    assert any(b"pytest" in line or b"python" in line for line in command_lines(os.getppid()))
    assert footprint(None)["processes"] == 0
