"""The report directory may be impossible, taken, full of traps or gone: one sentence, and nothing is written elsewhere."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import pytest

from .vendor import Outcome, Repository

LONG = pytest.mark.long
SUITE = ("--pyargs", "pytest_otmcp.conformance", "--otmcp-reps=1", "-k", "normal and (M1 or M2)")


def refused(outcome: Outcome, code: int, sentence: str) -> None:
    """Check that a run ended with this code and sentence, and without a traceback."""
    assert outcome.code == code, outcome.output
    assert sentence in " ".join(outcome.output.split())
    assert "Traceback" not in outcome.output
    assert "INTERNALERROR" not in outcome.output


@pytest.mark.parametrize("directory", ["/proc/x", pytest.param("/sys/x/y", marks=LONG)])
def test_a_directory_that_cannot_be_is_refused_before_the_first_item(
    empty_repository: Repository, directory: str
) -> None:
    empty_repository.subject()
    outcome = empty_repository.pytest(*SUITE, f"--otmcp-report-dir={directory}")
    refused(outcome, 2, f"--otmcp-report-dir: {directory} cannot be written to: ")
    assert "M1" not in outcome.output


@LONG
def test_a_directory_of_another_run_is_refused_before_the_first_item(empty_repository: Repository) -> None:
    empty_repository.subject()
    folder = empty_repository.root / "reports" / "latest"
    folder.mkdir(parents=True)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        refused(empty_repository.pytest(*SUITE), 2, f"another run is writing to {folder}; wait for its end")
    finally:
        os.close(descriptor)
    assert empty_repository.pytest(*SUITE).code == 1


@pytest.mark.long
def test_links_in_the_directory_are_not_followed(empty_repository: Repository) -> None:
    empty_repository.subject()
    folder = empty_repository.root / "reports" / "latest"
    (folder / "tables").mkdir(parents=True)
    mine = empty_repository.root / "mine"
    mine.write_text("mine", encoding="utf-8")
    names = ("run.json", "run.json.new", "report.html", "summary.md", "tables/tab_results.tex", "figures")
    for name in names:
        (folder / name).symlink_to(mine)
    elsewhere = empty_repository.root / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "mine").write_text("mine", encoding="utf-8")
    (folder / "run.parts").symlink_to(elsewhere)
    outcome = empty_repository.pytest(*SUITE)
    assert outcome.statuses == {"M1": "PASS", "M2": "PASS"}
    assert mine.read_text(encoding="utf-8") == "mine"
    assert [name for name in names if (folder / name).is_symlink()] == []
    assert (folder / "report.html").is_file()
    # Samples were not put where the link led to.
    assert not (folder / "run.parts").is_symlink()
    assert [path.name for path in elsewhere.iterdir()] == ["mine"]


AFTER_AN_ITEM = """
import pathlib, shutil

def pytest_runtest_logfinish(nodeid, location):
    folder = pathlib.Path("reports", "latest")
    if "M1" in nodeid:
        {act}
"""
ACTS = {
    "shutil.rmtree(folder)": "run.json cannot be written: ",
    "shutil.rmtree(folder); folder.write_text('')": "run.parts cannot be made any more: ",
    "path = folder / 'run.json'; path.write_bytes(path.read_bytes().replace(b'PASS', b'PISS'))": (
        "run.json cannot be written: another program has changed it"
    ),
    "(folder / 'run.json').rename(folder / 'r'); (folder / 'run.json').symlink_to('r')": "run.json cannot be written: ",
}


@pytest.mark.parametrize("act", [act if "PISS" in act else pytest.param(act, marks=LONG) for act in ACTS])
@pytest.mark.long
def test_a_directory_that_is_changed_during_a_run_ends_it_in_one_sentence(
    empty_repository: Repository, act: str
) -> None:
    empty_repository.subject()
    empty_repository.write(act_py=AFTER_AN_ITEM.format(act=act))
    outcome = empty_repository.pytest(*SUITE, plugins="act", path=(Path(empty_repository.root),))
    refused(outcome, 3, ACTS[act])
    assert "CONFORMANT (" not in outcome.output
