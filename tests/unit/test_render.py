"""All reports are written from a record alone, and a report that fails prevents no other report."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.core.matrix import repetitions
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record import load
from pytest_otmcp.record.writer import RunWriter, laid_out
from pytest_otmcp.report import command
from pytest_otmcp.report.capabilities import Earned, Grade, earned
from pytest_otmcp.report.families import css_class, families, style_sheet
from pytest_otmcp.report.html import page
from pytest_otmcp.report.markdown import summary
from pytest_otmcp.report.render import NAMES, reason, write_all
from pytest_otmcp.suite.catalogue import all_tasks

from ..stored_runs import header_of
from .samples import adapter, finding, item, run, written_twice
from .test_latex import ALL


def test_every_report_is_written_below_the_directory(tmp_path: Path) -> None:
    directory = tmp_path / "new" / "report"
    assert write_all(run(ALL), directory) == {}
    assert sorted(path.name for path in directory.iterdir()) == sorted(NAMES)
    assert (directory / "report.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert (directory / "summary.md").read_text(encoding="utf-8").startswith("## ✅ CONFORMANT")
    assert (directory / "tables" / "tab_results.tex").is_file()
    assert (directory / "figures" / "recovery_phases.png").is_file()


def test_every_report_is_written_of_a_run_that_was_killed(tmp_path: Path) -> None:
    record = run([])
    path = tmp_path / "run.json"
    writer = RunWriter(path, header_of(record))
    failed = written_twice()
    writer.append(failed, laid_out(failed.pop("samples")))
    assert write_all(load(path, allow_incomplete=True), tmp_path) == {}
    assert "The run is not complete: the run did not end." in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_the_same_record_gives_the_same_texts() -> None:
    one, two = (run([*ALL, written_twice(3)]) for _ in range(2))
    assert page(one) == page(two)
    assert summary(one) == summary(two)


def test_a_report_that_cannot_be_written_is_named_removed_and_hides_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(run: Any, path: Path) -> None:
        raise ValueError("no such colour")

    # Files that an earlier run left would describe another run.
    (tmp_path / "figures").mkdir()
    for stale in ("report.html", "figures/recovery_phases.png"):
        (tmp_path / stale).write_text("stale")
    monkeypatch.setattr("pytest_otmcp.report.figures.write_figures", broken)
    monkeypatch.setattr("pytest_otmcp.report.html.page", lambda run: 1 / 0)
    failed = write_all(run(ALL), tmp_path)
    assert {name: reason(error) for name, error in failed.items()} == {
        "report.html": "ZeroDivisionError: division by zero",
        "figures": "ValueError: no such colour",
    }
    assert sorted(path.name for path in tmp_path.iterdir()) == ["summary.md", "tables", "verdict.json"]


@pytest.mark.parametrize("suite", ["normal", "fault", "stress", "recovery"])
@pytest.mark.parametrize("repetition", [0, 1, 2, 7, 29])
def test_the_command_runs_just_so_many_repetitions_that_the_failing_one_is_among_them(
    suite: str, repetition: int
) -> None:
    words = shlex.split(command(run([]), item("X1", suite, "Modbus", "x", []), repetition))
    assert words[:3] == ["pytest", "--pyargs", "pytest_otmcp.conformance"]
    assert words[-2:] == ["-k", "[X1]"]
    reps = int(next(word for word in words if word.startswith("--otmcp-reps=")).partition("=")[2])
    assert repetitions(reps)[suite] > repetition
    assert reps == 1 or repetitions(reps - 1)[suite] <= repetition


def test_the_command_repeats_what_was_unusual_about_the_run() -> None:
    record = run([])
    record["settings"] |= {"seed": 7, "era": "legacy", "time_scale": 2.0, "broker": "mqtt://h:1", "subject": "my.toml"}
    record["settings"] |= {"suites": ["normal", "fault"]}
    record["settings"] |= {"soak": True, "protocols": ["dnp3", "s7"]}
    assert command(record) == (
        "pytest --pyargs pytest_otmcp.conformance --otmcp-reps=30 --otmcp-suite=normal,fault --otmcp-seed=7 "
        "--otmcp-era=legacy --otmcp-time-scale=2.0 --otmcp-broker=mqtt://h:1 --otmcp-protocols=dnp3,s7 --otmcp-soak --otmcp-subject=my.toml"
    )


def test_the_command_cannot_be_left_by_the_name_of_an_item() -> None:
    words = shlex.split(command(run([]), item("x'; rm -rf $HOME; '", "normal", "Modbus", "x", [])))
    assert words[-1] == "[x'; rm -rf $HOME; ']"


def grades(*items: dict[str, Any]) -> dict[str, dict[str, Earned]]:
    return {capability.name: by_family for capability, by_family in earned(run(list(items)))}


def modbus(identifier: str, status: str = "PASS", suite: str = "normal") -> dict[str, Any]:
    return {**item(identifier, suite, "Modbus", "x", [1.0]), "status": status}


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ("PASS", "PASS", Earned(grade=Grade.EARNED, because=("M1", "M2"))),
        ("PASS", "FAIL", Earned(grade=Grade.NOT_EARNED, because=("M2",))),
        ("NOT_TESTABLE", "PASS", Earned(grade=Grade.NOT_EARNED, because=("M1",))),
        ("KIT_ERROR", "FAIL", Earned(grade=Grade.NOT_EARNED, because=("M2",))),
        ("KIT_ERROR", "PASS", Earned(grade=Grade.UNDECIDED, because=("M1",))),
        ("PASS", "INTERRUPTED", Earned(grade=Grade.UNDECIDED, because=("M2",))),
        ("NOT_APPLICABLE", "NOT_APPLICABLE", Earned(grade=Grade.NOT_ASKED, without=("M1", "M2"))),
        ("NOT_APPLICABLE", "PASS", Earned(grade=Grade.EARNED, because=("M2",), without=("M1",))),
        # That the device can be reached is no value.
        ("PASS", "NOT_APPLICABLE", Earned(grade=Grade.NOT_ASKED, without=("M1", "M2"))),
    ],
)
def test_a_capability_is_earned_when_every_item_behind_it_passed(first: str, second: str, expected: Earned) -> None:
    assert grades(modbus("M1", first), modbus("M2", second))["Reading"]["Modbus"] == expected


AWAY = modbus("S10", suite="stress")
"""What takes the adapter through an outage."""


def refused(identifier: str, requirement: str, status: str = "FAIL", strength: str = "MUST") -> dict[str, Any]:
    found = {**finding("device_differs", "it holds 4464", requirement), "strength": strength}
    return {**modbus(identifier, status, "fault"), "findings": [found]}


def test_a_finding_takes_away_what_its_requirement_is_about_whichever_item_it_is_in() -> None:
    behind = [modbus("M3"), item("S4", "stress", "Modbus", "x", [1.0]), AWAY]
    assert grades(*behind)["Writing"]["Modbus"] == Earned(grade=Grade.EARNED, because=("M3",))
    truncated = grades(*behind, refused("FM2", "ADR-003"))
    assert truncated["Writing"]["Modbus"] == Earned(grade=Grade.NOT_EARNED, because=("FM2",))
    assert truncated["Reading"]["Modbus"].grade is not Grade.NOT_EARNED
    both = grades(modbus("M3", "FAIL"), refused("FM2", "ADR-003"))
    assert both["Writing"]["Modbus"] == Earned(grade=Grade.NOT_EARNED, because=("M3", "FM2"))


def test_a_recommendation_a_fault_of_the_kit_and_a_rule_about_answers_take_nothing_away() -> None:
    kept = Earned(grade=Grade.EARNED, because=("M3",))
    for other in (
        refused("FM2", "ADR-003", "PASS", "SHOULD"),
        refused("FM2", "ADR-003", strength="SHOULD"),
        refused("FM2", "ADR-003", "KIT_ERROR"),
        refused("FM2", "ENV-001"),
        refused("FM2", "ACME 7"),
    ):
        assert grades(modbus("M3"), AWAY, other)["Writing"]["Modbus"] == kept


def test_an_item_that_failed_for_something_else_does_not_show_a_capability_and_does_not_take_it_away() -> None:
    malformed = {**modbus("M3", "FAIL"), "findings": [finding("no_envelope", "a text", "ENV-001")]}
    assert grades(malformed, AWAY)["Writing"]["Modbus"] == Earned(grade=Grade.UNDECIDED, because=("M3",))
    written = {**malformed, "findings": [*malformed["findings"], finding("device_differs", "it holds 4464", "WR-001")]}
    assert grades(written, AWAY)["Writing"]["Modbus"] == Earned(grade=Grade.NOT_EARNED, because=("M3",))


def test_write_protection_is_lost_by_what_was_written_whichever_requirement_is_cited() -> None:
    failed = {**modbus("M3", "FAIL"), "capabilities": ["write_protection"]}
    for code, grade in (("not_successful", Grade.UNDECIDED), ("wrote", Grade.NOT_EARNED)):
        record = grades({**failed, "findings": [finding(code, "x", "MCP-008")]})
        assert record["Write protection"]["Modbus"].grade is grade


def test_what_is_claimed_is_lost_by_a_finding_though_no_item_about_it_applies_and_what_is_not_claimed_is_not() -> None:
    record = run([modbus("M3", "NOT_APPLICABLE"), refused("FM2", "WR-001")])
    by_name = {capability.name: by_family for capability, by_family in earned(record)}
    assert by_name["Writing"]["Modbus"] == Earned(grade=Grade.NOT_EARNED, because=("FM2",), without=("M3",))
    record["subject"]["adapters"]["modbus"] = adapter(1, unclaimed={"write_holding": "only reads"})
    by_name = {capability.name: by_family for capability, by_family in earned(record)}
    assert by_name["Writing"]["Modbus"] == Earned(grade=Grade.NOT_CLAIMED, without=("M3",))


def test_writing_is_not_earned_without_an_outage() -> None:
    def writing(*away: dict[str, Any]) -> Earned:
        return grades(modbus("M3"), *away)["Writing"]["Modbus"]

    missing = ("S10", "R-modbus")
    assert writing() == Earned(grade=Grade.UNDECIDED, because=missing)
    without = [modbus(name, "NOT_APPLICABLE") for name in missing]
    assert writing(*without) == Earned(grade=Grade.NOT_ASKED, without=missing)
    assert writing(without[0], modbus("R-modbus", suite="recovery")) == Earned(grade=Grade.EARNED, because=("M3",))


def test_a_capability_whose_item_did_not_run_is_not_earned() -> None:
    assert grades(modbus("M1"))["Reading"]["Modbus"] == Earned(grade=Grade.UNDECIDED, because=("M2",))


def test_checks_are_about_the_capabilities_of_their_rows() -> None:
    record = run([modbus(name, suite="requirements") for name in all_tasks() if name.endswith(".modbus")])
    record["settings"]["suites"] = ["requirements"]
    by_name = {capability.name: by_family["Modbus"] for capability, by_family in earned(record)}
    assert all(by_name[name].grade == Grade.EARNED for name in ("Reading", "Writing", "Write protection"))
    assert "RD-001.modbus" in by_name["Reading"].because
    assert "WR-001.modbus" not in by_name["Reading"].because
    record["items"] = [one for one in record["items"] if one["id"] != "RD-001.modbus"]
    by_name = {capability.name: by_family["Modbus"] for capability, by_family in earned(record)}
    assert by_name["Reading"] == Earned(grade=Grade.UNDECIDED, because=("RD-001.modbus",))
    assert by_name["Writing"].grade == Grade.EARNED


def test_what_no_item_tests_is_said_to_be_untested() -> None:
    crossed = item("X1", "normal", "Cross-protocol", "x", [1.0])
    assert grades(crossed)["Write protection"]["Cross-protocol"] == Earned(grade=Grade.NOT_TESTED)


def test_write_protection_is_not_earned_by_writing_where_it_is_not_claimed() -> None:
    record = run([item("Q3", "normal", "MQTT", "x", [1.0])])
    record["subject"]["adapters"] = {"mqtt": adapter(5, unclaimed={"guard": "always writes"})}
    by_name = {capability.name: by_family for capability, by_family in earned(record)}
    assert by_name["Write protection"]["MQTT"] == Earned(grade=Grade.NOT_CLAIMED)
    assert by_name["Writing"]["MQTT"].grade != Grade.NOT_CLAIMED


def test_the_failure_of_an_item_that_no_capability_knows_is_not_overlooked() -> None:
    further = grades(modbus("M1"), modbus("WR-099", "FAIL"))["Further requirements"]
    assert further["Modbus"] == Earned(grade=Grade.NOT_EARNED, because=("WR-099",))
    assert "Further requirements" not in grades(modbus("M1"))


def test_an_item_counts_for_what_it_says_itself() -> None:
    own = {**modbus("WR-099", "FAIL"), "capabilities": ["writing"]}
    assert grades(modbus("M3"), own)["Writing"]["Modbus"] == Earned(grade=Grade.NOT_EARNED, because=("WR-099",))
    unheard = {**modbus("WR-099", "FAIL"), "capabilities": ["flying"]}
    assert grades(unheard)["Further requirements"]["Modbus"].grade is Grade.NOT_EARNED


def test_families_are_in_the_order_of_the_registry_and_unknown_ones_last() -> None:
    names = ("HART", "Cross-protocol", "OPC UA", "Modbus")
    record = run([item(f"A{index}", "normal", name, "x", [1.0]) for index, name in enumerate(names)])
    assert families(record) == ["Modbus", "OPC UA", "Cross-protocol", "HART"]


def test_every_protocol_has_its_colours_on_light_and_on_dark_pages() -> None:
    for protocol in protocols().values():
        shown = style_sheet()
        assert f"--{protocol.key}: {protocol.colour.light};" in shown.splitlines()[0]
        assert f"--{protocol.key}: {protocol.colour.dark};" in shown.splitlines()[1]
        assert css_class(protocol.name) == protocol.key


def test_every_task_of_the_benchmark_stands_behind_some_capability() -> None:
    from pytest_otmcp.suite.catalogue import tasks_by_id

    tasks = [task for task in tasks_by_id().values() if task.suite in ("normal", "fault", "stress", "recovery")]
    items = [item(task.id, task.suite, task.family, task.title, [1.0]) for task in tasks]
    assert "Further requirements" not in grades(*items)
    missing = [
        name
        for name, by_family in grades(*items).items()
        for one in by_family.values()
        if one.grade not in (Grade.EARNED, Grade.NOT_TESTED)
    ]
    assert missing == []
