"""The plan: a key is a digest of all that a row depends on, and nothing is planned that cannot be meant."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from pytest_otmcp import cli
from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.fleet.plan import PLAN, ROWS, planned, read_row, write_plan

from .rows import plan, subject


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    subject(tmp_path, "one")
    (tmp_path / "one" / ".venv").mkdir()
    (tmp_path / "one" / ".venv" / "binary").write_bytes(b"\xff")
    (tmp_path / "one" / "bindings.py").write_text("RATE = 1\n")
    return tmp_path


def keys(file: Path) -> list[str]:
    return [row.key for row in planned(file)[1]]


def test_a_row_is_planned_under_its_version_and_nothing_else_of_its_subject_file_is_different(folder: Path) -> None:
    (row,) = planned(plan(folder, "one 1.2 one"))[1]
    found = tomllib.loads(row.files[row.subject])
    before = tomllib.loads((folder / "one" / "otmcp.toml").read_text())
    assert found == {**before, "subject": {**before["subject"], "version": "1.2"}}
    assert sorted(row.files) == ["bindings.py", "otmcp.toml"]


def test_the_key_follows_from_subject_environment_version_and_settings(folder: Path) -> None:
    first = keys(plan(folder, "one 1 one"))
    assert keys(plan(folder, "one 1 one")) == first
    seen = {*first}
    for rows, settings in (
        ("one 2 one", "reps = 1"),
        ('one 1 one install = ["true"]', "reps = 1"),
        ('one 1 one env = { A = "1" }', "reps = 1"),
        ("one 1 one", "reps = 2"),
    ):
        seen.update(keys(plan(folder, rows, settings=settings)))
    (folder / "one" / "bindings.py").write_text("RATE = 2\n")
    seen.update(keys(plan(folder, "one 1 one")))
    assert len(seen) == 6


def test_a_row_that_was_changed_is_not_carried_out(folder: Path) -> None:
    write_plan(plan(folder, "one 1 one"), folder / "fleet")
    (path,) = (folder / "fleet" / ROWS).iterdir()
    assert read_row(path).version == "1"
    path.write_text(path.read_text().replace("reads alone", "reads"))
    with pytest.raises(UsageError, match="the row was changed after it was planned"):
        read_row(path)


@pytest.mark.parametrize(
    ("rows", "settings", "words"),
    [
        (["one 1 one", "one 1 one"], "", "one 1 is planned 2 times"),
        ([], "row = []", "a fleet has a row"),
        (["one 1 two"], "", "there is no such file"),
        (['one 1 one image = "acme:latest"'], "", "expected NAME@sha256:DIGEST"),
        (['one 1 one image = "acme"\ninstall = ["true"]'], "", "an image is installed already"),
        (["one 1 one"], 'isolation = "some"', "expected one of auto, require, off"),
        (["one 1 one instal = []"], "", "unknown field `instal`"),
        (
            ["one 1 one install = ['sh -c \"x']"],
            "",
            "one 1: install: .* cannot be split into words: No closing quotation",
        ),
        (['one 1 one install = [""]'], "", "one 1: install: expected a command, found ''"),
        (['one 1 one install = ["a\\u0000b"]'], "", "one 1: install: expected a command"),
        (['one 1 one env = { "A=B" = "1" }'], "", "one 1: env: no variable can be 'A=B' = '1'"),
        (['one 1 one env = { A = "\\u0000" }'], "", "one 1: env: no variable can be 'A'"),
    ],
)
def test_a_plan_that_cannot_be_meant_is_refused(folder: Path, rows: list[str], settings: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        write_plan(plan(folder, *rows, settings=settings), folder / "fleet")


def test_a_subject_file_whose_version_cannot_be_written_is_refused(folder: Path) -> None:
    (folder / "one" / "otmcp.toml").write_text('subject = { name = "one" }\n')
    with pytest.raises(UsageError, match="needs a line version"):
        write_plan(plan(folder, "one 1 one"), folder / "fleet")


def test_the_command_says_what_is_left_to_do(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = plan(folder, "one 1 one", "one 2 one")
    assert cli.main(["fleet", "plan", str(file), "--out", str(folder / "fleet")]) == 0
    assert "2 rows planned, 0 of them carried out before" in capsys.readouterr().out
    document = json.loads((folder / "fleet" / PLAN).read_text())
    assert [(row["id"], row["version"]) for row in document["rows"]] == [("one", "1"), ("one", "2")]
