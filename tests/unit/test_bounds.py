"""What an adapter was told to allow: patterns of targets, and the launches that a subject file describes for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.core.verdict import Status
from pytest_otmcp.protocols.bounds import Bounds, Limit, Times
from pytest_otmcp.subject.load import load_subject
from pytest_otmcp.suite.catalogue import all_tasks
from pytest_otmcp.trial.applicability import applicability, participants

SMALLEST = """
[subject]
name = "Acme"
version = "1"

[adapter.s7]
command = ["acme"]
env = { BASE = "1" }
rw = { env = { WRITES = "on", CONTROL = "on" }, args = ["--rw"] }
"""


@pytest.mark.parametrize(
    ("pattern", "covered", "others"),
    [
        (
            "1/holding_registers/10..19",
            ("1/holding_registers/10", "1/holding_registers/19"),
            ("1/holding_registers/9",),
        ),
        (
            "1/holding_registers/10..19",
            (),
            ("1/holding_registers/20", "1/holding_registers/100", "2/holding_registers/10"),
        ),
        ("control/*/speed", ("control/line-1/speed",), ("control/a/b/speed", "control/speed", "control/a/speed2")),
        ("ns=2;s=Valve", ("ns=2;s=Valve",), ("ns=2;s=Valve2", "ns=22;s=Valve")),
        ("DB10.DBB2..3", ("DB10.DBB2", "DB10.DBB3"), ("DB10xDBB2", "DB10.DBB02x")),
    ],
)
def test_a_pattern_covers_what_it_says_and_nothing_beside_it(
    pattern: str, covered: tuple[str, ...], others: tuple[str, ...]
) -> None:
    bounds = Bounds(allowed=(pattern,))
    assert all(map(bounds.allows, covered))
    assert not any(map(bounds.allows, others))


def test_bounds_are_the_same_after_they_were_recorded() -> None:
    bounds = Bounds(allowed=("a", "b..c"), limits={"a": Limit(lowest=0.0, every_s=0.4)})
    assert Bounds.of_record(bounds.as_record()) == bounds


def written(tmp_path: Path, more: str) -> Path:
    path = tmp_path / "otmcp.toml"
    path.write_text(SMALLEST + more, encoding="utf-8")
    return path


def test_further_launches_begin_with_that_with_writes_enabled(tmp_path: Path) -> None:
    more = 'no_control = { env = { CONTROL = "off" } }\nbounded = { args = ["--allow=x"], allowed = ["x"] }\n'
    adapter = load_subject(written(tmp_path, more)).adapters["s7"]
    assert adapter.variants["no_control"].env == {"BASE": "1", "WRITES": "on", "CONTROL": "off"}
    assert adapter.variants["bounded"].command == ("acme", "--rw", "--allow=x")
    assert adapter.bounds == Bounds(allowed=("x",))


def test_a_bounded_launch_that_was_told_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="'allowed' or 'limits'"):
        load_subject(written(tmp_path, 'bounded = { args = ["--allow=x"] }\n'))


def test_a_file_without_these_launches_is_not_asked_for_them(tmp_path: Path) -> None:
    adapters = load_subject(written(tmp_path, "")).adapters
    tasks = all_tasks()
    for row in ("WR-006.s7", "WR-007.s7"):
        assert applicability(tasks[row], adapters) == (
            Status.NOT_APPLICABLE,
            "s7.bounds is not claimed: the subject file has no launch 'bounded'",
        )
    assert participants(tasks["WR-004.s7"], adapters) == ["s7", "s7@ro"]


def test_a_launch_without_control_takes_part_in_the_check_of_the_write_switch(tmp_path: Path) -> None:
    adapters = load_subject(written(tmp_path, 'no_control = { env = { CONTROL = "off" } }\n')).adapters
    assert participants(all_tasks()["WR-004.s7"], adapters) == ["s7", "s7@ro", "s7@no_control"]


def test_a_launch_with_other_limits_of_time_says_what_follows_from_them(tmp_path: Path) -> None:
    more = 'retimed = { env = { TIMEOUT = "0.1" }, deadline_s = 2, attempts = 3 }\n'
    adapters = load_subject(written(tmp_path, more)).adapters
    env = adapters["s7"].variants["retimed"].env
    assert (env["BASE"], env["WRITES"], env["TIMEOUT"]) == ("1", "on", "0.1")
    times = adapters["s7"].times
    assert times == Times(deadline_s=2.0, attempts=3)
    assert times is not None
    assert Times.of_record(times.as_record()) == times
    assert participants(all_tasks()["TMO-002.s7"], adapters) == ["s7", "s7@retimed"]


def test_a_launch_with_other_limits_of_time_needs_a_deadline(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="deadline_s"):
        load_subject(written(tmp_path, 'retimed = { env = { TIMEOUT = "0.1" } }\n'))


def test_a_file_without_other_limits_of_time_is_asked_with_the_usual_ones_alone(tmp_path: Path) -> None:
    adapters = load_subject(written(tmp_path, "")).adapters
    assert participants(all_tasks()["TMO-002.s7"], adapters) == ["s7"]
