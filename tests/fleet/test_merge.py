"""The matrix: what is refused, what has changed, what the page and the files for programs say."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from pytest_otmcp import cli
from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.fleet.changes import changes
from pytest_otmcp.fleet.lines import Line, objection
from pytest_otmcp.fleet.outcome import RESULT, Outcome, Tries, judged, read_result
from pytest_otmcp.fleet.page import read_lines, write_pages
from pytest_otmcp.fleet.plan import PLAN, Kit, read_plan

from .lines import LYING, row, told

NEVER = {"verdict": "NOT CONFORMANT", "items": {"Modbus": {"passed": 0}}, "causes": [{"code": "cannot_start"}]}


@pytest.mark.parametrize(
    ("verdict", "outcome"),
    [
        (told("reference-modbus"), Outcome.CONFORMANT),
        (told(LYING), Outcome.NOT_CONFORMANT),
        (NEVER, Outcome.DID_NOT_START),
        # It came to a session: that it does not start while the device is away is a fault like others.
        ({**NEVER, "items": {"Modbus": {"passed": 1}}}, Outcome.NOT_CONFORMANT),
        ({**told("reference-modbus"), "narrowed": ["-k M1"]}, Outcome.NARROWED),
        ({**told("reference-modbus"), "verdict": "INCOMPLETE"}, Outcome.NARROWED),
        ({**told("reference-modbus"), "verdict": "INDETERMINATE"}, Outcome.FAULT),
    ],
)
def test_the_outcome_is_read_from_the_verdict(verdict: dict[str, Any], outcome: Outcome) -> None:
    assert judged(verdict) is outcome


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ([row("a", "1"), row("a", "1", record="other")], "a 1 is there twice"),
        ([row("a", "1", record="r"), row("b", "1", record="r")], "a 1 and b 1 are the same run"),
        (
            [
                row("a", "1"),
                replace(row("b", "1"), kit=Kit(version="0.2", digest="sha256:ef", suite_digest="sha256:cd")),
            ],
            r"b 1 was judged by another kit than the rows before it: pytest-otmcp 0.2 \(ef\)",
        ),
    ],
)
def test_rows_that_do_not_belong_together_are_refused(rows: list[Line], words: str) -> None:
    assert re.search(words, objection(rows) or "")


def test_rows_of_one_kit_belong_together() -> None:
    assert (
        objection([row("a", "1"), row("a", "2"), Line(key="k", id="b", version="1", outcome=Outcome.NOT_RUN)]) is None
    )


def test_only_what_was_conformant_can_break() -> None:
    before = [row("a", "1"), row("b", "1", LYING), row("c", "1"), row("gone", "1"), row("e", "1")]
    now = [
        row("a", "1", LYING, key="another"),
        row("b", "1", LYING),
        row("b", "2", LYING),
        row("c", "1"),
        row("c", "2", LYING),
        Line(key="k", id="e", version="1", outcome=Outcome.FAULT, reason="not installed", tries=3),
    ]
    found = changes(now, before)
    assert {*found.broke} == {("a", "1"), ("c", "2")}
    assert "1 was conformant" in found.broke["c", "2"]
    assert found.gone == ["gone 1"]
    assert [sentence.split(":")[0] for sentence in found.new] == ["b 2", "c 2"]
    assert found.unsteady == ["e 1: 3 tries, then fault of kit or machine: not installed"]
    assert found.without == ["e 1: fault of kit or machine: not installed"]


def test_a_forerunner_stands_before_or_was_replaced() -> None:
    # An older version that is added later has no forerunner, and fails by itself.
    found = changes([row("a", "1", LYING), row("a", "2")], [row("a", "2")])
    assert not found.broke
    assert {*changes([row("a", "2"), row("a", "3", LYING)], [row("a", "2")]).broke} == {("a", "3")}
    assert {*changes([row("a", "3", LYING)], [row("a", "2")]).broke} == {("a", "3")}


@pytest.mark.parametrize("outcome", [Outcome.OUT_OF_TIME, Outcome.WRONG_SUBJECT, Outcome.NARROWED, Outcome.NOT_RUN])
@pytest.mark.parametrize("before", [None, [row("a", "1")]])
def test_a_row_without_a_full_verdict_is_told(outcome: Outcome, before: list[Line] | None) -> None:
    found = changes([Line(key="k", id="a", version="1", outcome=outcome, reason="why")], before)
    assert found.without == [f"a 1: {outcome}: why"]
    assert "## Without a full verdict" in found.markdown(compared=before is not None)


def test_only_rows_with_a_key_are_the_same_and_only_outcomes_of_the_adapter_are_unsteady() -> None:
    assert not changes([row("a", "1", key="")], [row("a", "1", LYING, key="")]).unsteady
    missing = Line(key="a-1", id="a", version="1", outcome=Outcome.NOT_RUN)
    assert not changes([row("a", "1")], [missing]).unsteady


def test_another_outcome_of_the_same_key_is_unsteady_and_a_mended_row_is_told() -> None:
    found = changes([row("a", "1")], [row("a", "1", LYING)])
    assert found.mended == ["a 1: was not conformant, now conformant"]
    assert "with the same kit, subject and environment" in found.unsteady[0]
    assert not found.broke


def test_a_torn_line_of_the_tries_is_skipped(tmp_path: Path) -> None:
    tries = Tries.of(tmp_path, "k")
    tries.begin()
    tries.fail("not installed")
    tries.path.write_bytes(tries.path.read_bytes() + b'{"began": "20\xff')
    assert tries.read() == (1, "not installed")


@pytest.mark.parametrize("content", [b'{"schema": "\xff"}', b"[" * 100_000, b""])
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / RESULT
    path.write_bytes(content)
    (tmp_path / PLAN).write_bytes(content)
    with pytest.raises(UsageError, match=RESULT):
        read_lines(path)
    with pytest.raises(UsageError, match=PLAN):
        read_plan(tmp_path)
    with pytest.raises(ValueError, match=RESULT):
        read_result(tmp_path)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["merge", "--again=-1", "fleet"], "expected a number from 0 on, found '-1'"),
        (["fleet", "run", '--snakemake=--cores "1', "fleet.toml"], "cannot be split into words: No closing quotation"),
    ],
)
def test_an_option_that_cannot_be_meant_is_refused(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if "run" in words:
        pytest.importorskip("snakemake", reason="Snakemake is not installed")
    assert cli.main(words) == 2
    assert said in capsys.readouterr().err


def test_the_files_say_the_same(tmp_path: Path) -> None:
    rows = [row("<b>a</b>", "1"), row("<b>a</b>", "2", LYING, tries=2), row("c", "1", certificate=True)]
    compared = changes(rows, [row("<b>a</b>", "2")])
    write_pages("A fleet", rows, compared, tmp_path, compared=True)
    assert read_lines(tmp_path / "fleet.json") == rows
    # A line for each row: a program can read a large file line by line.
    assert len((tmp_path / "fleet.json").read_text().splitlines()) == 4
    page = (tmp_path / "index.html").read_text()
    assert "<b>a</b>" not in page
    assert len(re.findall(r'<tr class="(?:first|again)', page)) == 3
    assert 'src="runs/c-1/badge.svg"' in page
    assert 'href="runs/c-1/certificate.html"' in page
    assert "2 tries" in page
    suite = ElementTree.parse(tmp_path / "junit.xml").getroot()[0]
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "1", "0")
    assert suite[1].find("failure") is not None
    assert "## Broke" in (tmp_path / "changes.md").read_text()
