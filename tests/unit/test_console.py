"""The closing lines say what happened."""

from __future__ import annotations

from pytest_otmcp.report.console import summary

from .samples import item, run
from .test_latex import ALL


def text(record: dict[str, object], width: int = 120) -> str:
    return "\n".join(line for line, _ in summary(record, width))


def test_the_last_line_is_the_verdict() -> None:
    assert text(run(ALL)).splitlines()[-1] == "VERDICT: CONFORMANT (150/150 runs passed in 6 items)"


def test_thirty_passes_are_printed_with_their_bound() -> None:
    assert "30/30     90.5 %" in text(run(ALL))


def test_a_failing_item_shows_its_findings() -> None:
    shown = text(run([item("M2", "normal", "Modbus", "Read.", [1.0] * 7, failing=2)]))
    assert "rep 6/7: values differ" in shown


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
