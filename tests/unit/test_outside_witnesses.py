"""A witness that did not run, and a wall that was not tried, are named with the reason."""

from __future__ import annotations

from dataclasses import dataclass

from ..outside_witnesses import not_run


@dataclass
class Report:
    nodeid: str
    longrepr: tuple[str, int, str]


def skipped(nodeid: str, reason: str) -> Report:
    return Report(nodeid, ("test.py", 1, f"Skipped: {reason}"))


def test_each_reason_is_said_once_with_the_number_of_tests_and_other_skips_are_not_named() -> None:
    foreign = "tests/foreign_software/test_foreign_software.py::"
    reports = [skipped(f"{foreign}{name}", "npm is not installed") for name in "ab"]
    reports += [skipped("tests/walls/test_walls.py::e", "isolation is required")]
    reports += [skipped(f"{foreign}c", "mosquitto is not installed"), skipped("tests/unit/test_x.py::d", "no LaTeX")]
    assert list(not_run(reports)) == [
        "OUTSIDE WITNESS NOT RUN (tests with foreign software: 2): npm is not installed",
        "WALLS NOT TRIED (tests: 1): isolation is required",
        "OUTSIDE WITNESS NOT RUN (tests with foreign software: 1): mosquitto is not installed",
    ]
