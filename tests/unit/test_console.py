"""The closing lines on the terminal say what happened in the run."""

from __future__ import annotations

import copy
import re

from pytest_otmcp.report.console import summary
from pytest_otmcp.suite.requirements import requirements

from .samples import finding, item, run
from .test_latex import ALL


def text(record: dict[str, object], width: int = 120) -> str:
    return "\n".join(line for line, _ in summary(record, width))


def test_the_last_line_is_the_verdict() -> None:
    assert text(run(ALL)).splitlines()[-1] == "VERDICT: CONFORMANT (6 of 38 items applied, 150/150 runs passed)"


def test_warnings_stand_beside_the_verdict_and_are_told_once_for_each_kind() -> None:
    record = copy.deepcopy(run(ALL))
    warning = {**finding("no_text", "there is no text block", "MCP-006"), "strength": "SHOULD"}
    for warned in record["items"][:2]:
        for sample in warned["samples"]:
            sample["findings"] = [warning]
    shown = text(record)
    assert "warnings\n  MCP-006, 60 times in M1 M2: there is no text block\n" in shown
    assert shown.endswith("VERDICT: CONFORMANT (6 of 38 items applied, 150/150 runs passed, 1 warning)")
    assert "causes" not in shown


def test_thirty_passes_are_printed_with_their_bound() -> None:
    assert re.search(r"30/30 +90\.5 %", text(run(ALL)))


def test_a_failing_item_shows_its_findings() -> None:
    shown = text(run([item("M2", "normal", "Modbus", "Read.", [1.0] * 7, failing=2)]))
    assert "M2 rep 6/7, 2 times in all: values differ [wrong_value]" in shown


def test_an_incomplete_run_says_why() -> None:
    assert text(run(ALL, complete=False)).endswith("interrupted by the user)")


def test_withheld_latencies_are_explained() -> None:
    shown = text(run(ALL, timing_valid=False))
    assert "latencies withheld" in shown
    assert "1.50" not in shown


def test_no_table_row_is_wider_than_the_terminal() -> None:
    rows = [line for line, _ in summary(run(ALL), 80) if line.startswith("  ")]
    assert rows
    assert max(map(len, rows)) <= 80


def test_an_adapters_words_can_neither_colour_the_terminal_nor_forge_a_line() -> None:
    broken = item("M2", "normal", "Modbus", "Read.\x1b[2J", [1.0], failing=1)
    broken["samples"][0]["findings"][0]["message"] = "no\r\nVERDICT: CONFORMANT\x1b[32m \u202e \x9b"
    lines = text(run([broken])).splitlines()
    assert all(line.isprintable() for line in lines)
    assert [line for line in lines if line.startswith("VERDICT")] == [lines[-1]]
    assert r"        | VERDICT: CONFORMANT\x1b[32m \u202e \x9b [wrong_value]" in lines


def test_a_narrow_terminal_gets_no_column_of_means() -> None:
    assert "mean ms" in text(run(ALL), 120)
    assert "mean ms" not in text(run(ALL), 119)


def test_what_is_not_claimed_is_neither_passed_nor_failed() -> None:
    unclaimed = {**item("Q2", "normal", "MQTT", "Inspect.", []), "status": "NOT_APPLICABLE", "planned": 30}
    shown = text(run([*ALL, unclaimed]))
    assert "VERDICT: CONFORMANT (6 of 38 items applied, 150/150 runs passed)" in shown
    assert "causes" not in shown


def test_what_cannot_be_tested_says_why() -> None:
    why = "modbus: the subject binds no tool to the operation 'ping'"
    untestable = {**item("M1", "normal", "Modbus", "Ping.", []), "status": "NOT_TESTABLE", "planned": 3, "reason": why}
    assert why in text(run([untestable]))


def test_one_fault_is_printed_once_however_many_repetitions_show_it() -> None:
    broken = item("M2", "normal", "Modbus", "Read.", [1.0] * 7, failing=3)
    for index, sample in enumerate(broken["samples"][4:]):
        sample["findings"][0]["message"] = f"values should be [{index}, 7], the reply says [{index + 1}.5]"
    shown = text(run([broken]))
    assert shown.count("values should be") == 1
    assert "M2 rep 5/7, 3 times in all: values should be [0, 7], the reply says [1.5] [wrong_value]" in shown


def test_the_keys_of_the_subject_file_that_may_be_why_are_named() -> None:
    late = item("FM1", "fault", "Modbus", "Read.", [1.0], failing=1)
    assert "in the subject file: [adapter.modbus] probes.missing_address: Asked for instead of 9999." in text(
        run([late])
    )
    late["samples"][0]["findings"][0]["code"] = "no_reply"
    assert "in the subject file: deadline_s: Time within which every call must have answered." in text(run([late]))
    recovery = item("R-modbus", "recovery", "Modbus", "Recover.", [1.0], failing=1)
    assert "in the subject file: [adapter.modbus] recovery: How work goes on after an outage." in text(run([recovery]))
    dead = item("M1", "normal", "Modbus", "Ping.", [])
    dead |= {"status": "FAIL", "findings": [finding("cannot_start", "the adapter exited with code 1", "MCP-002")]}
    assert "in the subject file: era: 'legacy' for a server that must be" in text(run([dead]))
    assert "in the subject file" not in text(run([item("M2", "normal", "Modbus", "Read.", [1.0], failing=1)]))


def test_a_fault_that_turns_many_items_red_is_told_once_with_its_rule() -> None:
    broken = [item(name, "normal", "Modbus", "Read.", [1.0], failing=1) for name in ("M2", "M3")]
    shown = text(run([*broken, item("M1", "normal", "Modbus", "Ping.", [1.0])]))
    assert "  RD-001 Modbus: M2 M3" in shown.splitlines()
    assert shown.count("values differ") == 1
    assert requirements()["RD-001"].statement.split(".")[0][:50] in shown
