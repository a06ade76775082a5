"""Several runs side by side: one matrix, and what differs between them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp import cli
from pytest_otmcp.record.writer import RunWriter, laid_out
from pytest_otmcp.report.comparison import compared
from pytest_otmcp.report.comparison_pages import NAMES, html, markdown, write_comparison

from ..stored_runs import header_of
from .samples import item, run, written_twice
from .test_html import HOSTILE, Page, hostile
from .test_latex import M1, M2

UNCLAIMED = {
    **item("Q1", "normal", "MQTT", "Inspect.", []),
    "status": "NOT_APPLICABLE",
    "planned": 30,
    "reason": "the subject has no adapter for MQTT",
}
MENDED = {**item("M3", "normal", "Modbus", "Write a register.", [2.0] * 3), "requirements": ["WR-001", "WR-003"]}


def version(number: str, *items: dict[str, Any], reps: int = 30) -> dict[str, Any]:
    record = run(list(items))
    record["subject"] |= {"name": "acme-modbus", "version": number}
    record["settings"]["reps"] = reps
    return record


@pytest.fixture(scope="module")
def versions() -> list[dict[str, Any]]:
    """Three versions of an adapter: the first writes twice, the second does not, the third has an adapter for MQTT, too."""
    served = item("Q1", "normal", "MQTT", "Inspect.", [1.0] * 30)
    return [
        version("1", M1, M2, written_twice(3), UNCLAIMED),
        version("2", M1, M2, MENDED, UNCLAIMED),
        version("3", M1, M2, MENDED, served, reps=3),
    ]


def test_the_runs_are_columns_of_one_matrix(versions: list[dict[str, Any]]) -> None:
    found = compared(versions)
    assert [column.name for column in found.columns] == ["acme-modbus 1", "acme-modbus 2", "acme-modbus 3"]
    assert [column.verdict.text for column in found.columns] == ["NOT CONFORMANT", "CONFORMANT", "CONFORMANT"]
    rows = {row.name: [cell.text for cell in row.cells] for row in found.items}
    assert rows["M3"] == ["FAIL", "PASS", "PASS"]
    assert rows["Q1"] == ["n/a", "n/a", "PASS"]
    earned = {row.name: [cell.text for cell in row.cells] for row in found.capabilities}
    # None of them was taken through an outage.
    assert earned["Modbus: Writing"] == ["not earned", "undecided", "undecided"]
    assert earned["MQTT: Reading"][:2] == ["not claimed", "not claimed"]
    assert [(row.name, [cell.text for cell in row.cells]) for row in found.rules] == [
        ("Modbus: WR-003", ["violated", "kept", "kept"])
    ]


def test_runs_of_the_same_version_can_be_told_apart(versions: list[dict[str, Any]]) -> None:
    names = [column.name for column in compared([versions[0], versions[1], versions[0]]).columns]
    assert names == ["acme-modbus 1 (run 1)", "acme-modbus 2", "acme-modbus 1 (run 2)"]


def test_what_a_capability_means_is_said_once(versions: list[dict[str, Any]]) -> None:
    said = [row.about for row in compared(versions).capabilities if row.about]
    assert len(said) == len(set(said)) > 1
    assert len(said) < len(compared(versions).capabilities)


def test_what_changed_is_said_and_what_only_some_have_is_counted(versions: list[dict[str, Any]]) -> None:
    found = compared(versions)
    assert found.changes == ["M3 FAIL, PASS, PASS"]
    assert found.partial == 1
    assert {row.name for row in found.items if row.changed} == {"M3", "Q1"}
    assert found.notes == ("The repetitions differ (N = 30, 30, 3): more of them find what is rare.",)


def test_page_and_markdown_show_what_differs_before_what_does_not(versions: list[dict[str, Any]]) -> None:
    shown = Page(html(compared(versions)))
    assert shown.text.index("M3 Write a register. ✗ FAIL 0/3 ✓ PASS 3/3 ✓ PASS 3/3") < shown.text.index(
        "The runs agree on 2 of 4 items"
    )
    assert shown.values("class").count("changed") >= 3
    told = markdown(compared(versions))
    assert "| M3 | ❌ FAIL (0/3) | ✅ PASS (3/3) | ✅ PASS (3/3) |" in told
    assert "The runs agree on 2 of 4 items." in told
    assert "| M1 |" not in told


def test_nothing_that_an_adapter_wrote_becomes_markup(versions: list[dict[str, Any]]) -> None:
    harmful = Page(html(compared([hostile(versions[0]), versions[1]])))
    assert not {"script", "img"} & harmful.tags.keys()
    assert "<script>alert(1)</script>" in harmful.text
    assert HOSTILE not in markdown(compared([hostile(versions[0]), versions[1]]))


def test_runs_of_different_suites_or_without_an_end_are_said_to_be(versions: list[dict[str, Any]]) -> None:
    other = version("4", M1)
    other["kit"]["suite_digest"] = "sha256:" + "1" * 64
    other["footer"] |= {"complete": False, "reason": "interrupted by the user"}
    notes = compared([versions[0], other]).notes
    assert "The runs are of different suites: an item may ask for more in one than in the other." in notes
    assert "The run of acme-modbus 4 is not complete: interrupted by the user." in notes


def test_the_command_compares_records_and_says_what_changed(
    versions: list[dict[str, Any]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = []
    for index, record in enumerate(versions[:2]):
        path = tmp_path / f"{index}.json"
        writer = RunWriter(path, header_of(record))
        for entry in json.loads(json.dumps(record["items"])):
            writer.append(entry, laid_out(entry.pop("samples")))
        paths.append(str(path))
    assert cli.main(["report", *paths, "--out", str(tmp_path / "both")]) == 0
    told = capsys.readouterr().out
    assert "1 item went differently: M3 FAIL, PASS" in told
    assert sorted(path.name for path in (tmp_path / "both").iterdir()) == ["comparison.html", "comparison.md"]


def test_the_same_runs_give_the_same_bytes(versions: list[dict[str, Any]], tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_comparison(versions, tmp_path / name)
    for name in ("comparison.html", "comparison.md"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_a_link_in_the_directory_is_not_followed(versions: list[dict[str, Any]], tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.write_text("mine", encoding="utf-8")
    for name in NAMES:
        (tmp_path / name).symlink_to(mine)
    write_comparison(versions, tmp_path)
    assert mine.read_text(encoding="utf-8") == "mine"
    assert [(tmp_path / name).is_symlink() for name in NAMES] == [False, False]
