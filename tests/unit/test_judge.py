"""``otmcp judge``: a stored record, judged by the oracles of this kit, and what they find otherwise than it says."""

from __future__ import annotations

import gzip
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.cli import main
from pytest_otmcp.record import load
from pytest_otmcp.replay import rejudge
from tests.golden.files import path_of
from tests.stored_runs import store

DEFECT = "defect-MU-14p"
REPETITION = "P3 repetition 1"

Record = dict[str, Any]
Change = Callable[[Record], None]


@pytest.fixture
def judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[[Change], tuple[int, str]]:
    """``judged(change)`` judges the changed record of a defect and returns the exit code with what was printed."""

    def judge(change: Change) -> tuple[int, str]:
        plain = tmp_path / "run.json"
        plain.write_bytes(gzip.decompress(path_of(DEFECT).read_bytes()))
        record: Record = dict(load(plain))
        change(record)
        code = main(["judge", str(store(plain, record))])
        return code, capsys.readouterr().out

    return judge


def item(record: Record) -> Any:
    return next(item for item in record["items"] if item["id"] == "P3")


def sample(record: Record) -> Any:
    return item(record)["samples"][0]


def test_a_record_that_is_judged_as_it_says_differs_in_nothing(judged: Callable[[Change], tuple[int, str]]) -> None:
    code, told = judged(lambda record: None)
    assert code == 0
    assert told.endswith("run.json: 4 items, nothing differs\n")
    assert len(told.splitlines()) == 1


def test_a_record_of_another_kit_is_judged(judged: Callable[[Change], tuple[int, str]]) -> None:
    def made_elsewhere(record: Record) -> None:
        record["kit"] |= {"suite_digest": "sha256:" + "0" * 64, "version": "9.9.9"}

    assert judged(made_elsewhere)[0] == 0


def lose_a_finding(record: Record) -> None:
    sample(record)["findings"].pop(0)


def say_a_finding_that_there_is_not(record: Record) -> None:
    invented = {"code": "wrong_value", "message": "it is blue", "requirement": "RD-001", "evidence": None}
    sample(record)["findings"].append({**invented, "strength": "MUST", "cause": None})


def say_a_finding_in_other_words(record: Record) -> None:
    sample(record)["findings"][0]["message"] = "in other words"


def cite_another_requirement(record: Record) -> None:
    sample(record)["findings"][0]["requirement"] = "WR-003"


def call_it_a_fault_of_the_kit(record: Record) -> None:
    item(record)["status"] = "KIT_ERROR"


def lose_a_call(record: Record) -> None:
    sample(record)["calls"].pop(0)


FOUND = "WR-001 not_written_once: the segment should have seen one Data_Exchange of "

DIFFERENCES: dict[Change, tuple[list[str], str]] = {
    lose_a_finding: ([REPETITION, f"  new      {FOUND}"], "findings: 1 new"),
    say_a_finding_that_there_is_not: (
        [REPETITION, "  gone     RD-001 wrong_value: it is blue"],
        "findings: 1 gone",
    ),
    say_a_finding_in_other_words: (
        [REPETITION, f"  changed  {FOUND}", "      was  WR-001 not_written_once: in other words"],
        "findings: 1 changed",
    ),
    cite_another_requirement: (
        [REPETITION, f"  changed  {FOUND}", "      was  WR-003 not_written_once: the segment"],
        "findings: 1 changed",
    ),
    call_it_a_fault_of_the_kit: (["P3", '  status: "FAIL", was "KIT_ERROR"'], "other differences: 1"),
    lose_a_call: ([REPETITION, "  the steps ask for profibus read_inputs"], "other differences: 1"),
}
"""Change of a record to the beginnings of the lines that show it, and the end of the last line."""


@pytest.mark.parametrize("change", DIFFERENCES, ids=lambda change: change.__name__)
def test_what_is_judged_otherwise_is_shown_with_its_item_and_repetition(
    judged: Callable[[Change], tuple[int, str]], change: Change
) -> None:
    beginnings, sums = DIFFERENCES[change]
    code, told = judged(change)
    *lines, last = told.splitlines()
    assert code == 1
    assert [line.startswith(beginning) for line, beginning in zip(lines, beginnings, strict=False)] == [
        True for _ in beginnings
    ], told
    assert last.endswith(f"run.json: 4 items, {sums}")


def test_an_oracle_that_fails_is_shown_with_its_line(
    judged: Callable[[Change], tuple[int, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> object:
        return {}["missing"]

    monkeypatch.setattr(rejudge, "_of_sample", broken)
    code, told = judged(lambda record: None)
    assert code == 1
    assert "the stored history cannot be read (KeyError('missing') at test_judge.py:" in told


def test_of_several_records_each_is_judged(capsys: pytest.CaptureFixture[str]) -> None:
    path = str(path_of(DEFECT))
    assert main(["judge", path, path]) == 0
    assert capsys.readouterr().out.splitlines() == [f"{path}: 4 items, nothing differs"] * 2 + ["0 of 2 records differ"]


def cut_off(path: Path) -> str:
    path.write_bytes(path_of(DEFECT).read_bytes()[:5000])
    return "cannot be read (Compressed file ended"


def compressed_twice(path: Path) -> str:
    path.write_bytes(gzip.compress(path_of(DEFECT).read_bytes()))
    return "not a run record of schema"


def no_record(path: Path) -> str:
    path.write_text("{}")
    return "not a run record of schema"


def of_a_run_that_was_killed(path: Path) -> str:
    lines = gzip.decompress(path_of(DEFECT).read_bytes()).splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-2]))
    return "the run did not end, and its devices are not known"


def not_there(path: Path) -> str:
    return "cannot be read (No such file or directory)"


def of_a_protocol_that_is_not_installed(path: Path) -> str:
    path.write_bytes(gzip.decompress(path_of(DEFECT).read_bytes()))
    record: Record = dict(load(path))
    record["subject"]["adapters"]["hart"] = record["subject"]["adapters"].pop("profibus")
    store(path, record)
    return "no package that is installed here judges hart"


@pytest.mark.parametrize(
    "make",
    [
        cut_off,
        compressed_twice,
        no_record,
        of_a_run_that_was_killed,
        not_there,
        of_a_protocol_that_is_not_installed,
    ],
    ids=lambda make: make.__name__,
)
def test_a_file_that_cannot_be_judged_is_refused_in_one_sentence(
    make: Callable[[Path], str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.json.gz"
    reason = make(path)
    assert main(["judge", str(path)]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"otmcp: {path}: ")
    assert reason in told
    assert len(told.splitlines()) == 1


def test_nothing_that_speaks_to_adapters_or_devices_is_imported() -> None:
    # The SDK takes two thirds of the time that the command has.
    program = (
        "import sys; from pytest_otmcp.cli import main; main(sys.argv[1:]); "
        "print(sorted({'mcp', 'pymodbus', 'asyncua', 'paho', 'pytest'} & {*sys.modules}))"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", program, "judge", str(path_of(DEFECT))],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert (done.stdout.splitlines()[1:], done.stderr) == (["[]"], "")
