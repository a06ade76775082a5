"""``otmcp verify`` and ``otmcp report`` of files that an enemy has made: it ends within its bounds, and nothing of them reaches a terminal as it is."""

from __future__ import annotations

import copy
import json
import os
import re
import resource
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp.cli import Refusal, main
from pytest_otmcp.cli.confined import Bounds, confined
from pytest_otmcp.cli.examination import examine
from pytest_otmcp.record import load
from pytest_otmcp.soundness.warm_start import WarmStart
from tests.stored_runs import store

from .reference_run import reference_run

Record = dict[str, Any]

TERMINAL = re.compile(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""Everything but a line feed that moves a cursor, starts an escape sequence or turns text around."""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory, warm_start: WarmStart) -> Path:
    return reference_run(tmp_path_factory, warm_start)


@pytest.fixture(scope="module")
def genuine(path: Path) -> Record:
    """The record of that run with its first item, as if it had been ended then."""
    run: Record = load(path)
    ended = {"complete": False, "reason": "interrupted by the user", "verdict": "INCOMPLETE"}
    return {**run, "items": run["items"][:1], "footer": {**run["footer"], **ended}}


@pytest.fixture
def run(genuine: Record) -> Record:
    return copy.deepcopy(genuine)


def ping(run: Record) -> Record:
    """Return the rule for the output of the operation that the item performs."""
    rule: Record = run["subject"]["adapters"]["modbus"]["bindings"]["ping"][0]["outputs"]["reachable"]
    return rule


def verified(path: Path, bounds: Bounds) -> list[str]:
    """Return what is said of a record that is examined within these bounds."""
    asked = {"record": str(path), "subject": None, "certificate": None, "challenge": None}
    said: list[str] = confined("examination", asked, bounds, str(path))["said"]
    return said


def reported(path: Path, bounds: Bounds) -> list[str]:
    """Return what is said of the reports of a record, which are made within these bounds."""
    asked = {"records": [str(path)], "directory": str(path.parent / "out")}
    said: list[str] = confined("rendering", asked, bounds, str(path))["said"]
    return said


Work = Callable[[Path, Bounds], list[str]]
BOTH = pytest.mark.parametrize("work", [verified, reported])


# -- time and memory ------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_regular_expression_that_never_ends_is_ended(run: Record, tmp_path: Path) -> None:
    ping(run).update(path="meta.request_id", regex="^(([0-9a-z])+.?)+[!]")
    forged = store(tmp_path / "run.json", run)
    with pytest.raises(
        Refusal, match=r"run\.json cannot be examined within 1024 MB of memory and 1 s of the processor"
    ):
        verified(forged, Bounds(processor_s=1))


@pytest.mark.long
def test_reports_that_take_too_long_are_ended(path: Path, tmp_path: Path) -> None:
    copied = shutil.copy(path, tmp_path)
    with pytest.raises(
        Refusal, match=r"run\.json cannot be examined within 1024 MB of memory and 1 s of the processor"
    ):
        reported(Path(copied), Bounds(processor_s=1))


def lists(run: Record, path: Path, number: int) -> Path:
    """Store a record with this many lists; each takes 3 bytes of the file, and some sixty of memory."""
    run["settings"]["unknown"] = "here"
    forged = store(path, run)
    forged.write_bytes(forged.read_bytes().replace(b'"here"', b"[" + b"[]," * number + b"[]]"))
    return forged


@BOTH
@pytest.mark.long
def test_a_record_that_needs_too_much_memory_is_refused(run: Record, tmp_path: Path, work: Work) -> None:
    forged = lists(run, tmp_path / "run.json", 1 << 22)
    with pytest.raises(Refusal, match=r"run\.json cannot be examined within 256 MB of memory"):
        work(forged, Bounds(memory_mb=256))


@pytest.mark.long
@pytest.mark.parametrize("command", [["verify"], ["report"], ["report", "RUN"]])
def test_every_command_that_reads_records_has_bounds(
    run: Record, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    forged = lists(run, tmp_path / "run.json", 1 << 24)
    files = [str(path) if word == "RUN" else word for word in command]
    assert main([*files, str(forged)]) == 1
    told = capsys.readouterr()
    assert told.out == ""
    assert re.fullmatch(r"otmcp: refused: .*run\.json cannot be examined within 1024 MB of memory .*\n", told.err)


@pytest.mark.long
@pytest.mark.parametrize("work", [verified, reported])
def test_the_bounds_are_plenty_for_a_genuine_record(path: Path, tmp_path: Path, work: Work) -> None:
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    (found,) = work(Path(shutil.copy(path, tmp_path)), Bounds(memory_mb=512, processor_s=30))[:1]
    assert found.startswith(("verified: ", "the reports of "))
    # A sixth of what a record of any size is given: it is the margin for slower machines.
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before < 10


def many_images(run: Record) -> None:
    looks = run["items"][0]["samples"][0]["observations"]
    looks[:0] = [{**looks[0], "changes": []} for _ in range(10_000)]


def many_restarts(run: Record) -> None:
    run["items"][0]["devices"]["modbus"]["starts"] = 10**18


def a_long_slice(run: Record) -> None:
    end = next(seen for seen in run["items"][0]["samples"][0]["observations"] if "end" in seen)
    end["end"] = 10**18


def many_repetitions(run: Record) -> None:
    run["items"][0]["planned"] = run["settings"]["repetitions"]["normal"] = 10**18


def a_long_text(run: Record) -> None:
    run["items"][0]["title"] = "x" * 10**6


def a_deep_path(run: Record) -> None:
    ping(run).update(path="a" + ".a" * 50_000)


def deep_values(run: Record) -> None:
    value: Any = 0
    for _ in range(900):
        value = [value]
    run["items"][0]["samples"][0]["calls"][0]["envelope"]["data"]["reachable"] = value
    run["items"][0]["samples"][0]["calls"][0]["outputs"]["reachable"] = value


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(many_images, marks=pytest.mark.long),
        many_restarts,
        a_long_slice,
        many_repetitions,
        a_long_text,
        a_deep_path,
        deep_values,
    ],
)
def test_a_large_number_or_text_costs_nothing(run: Record, tmp_path: Path, change: Callable[[Record], None]) -> None:
    change(run)
    forged = store(tmp_path / "run.json", run)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_utime
    with pytest.raises(Refusal) as refusal:
        examine(forged)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_utime - before < 5
    assert len(str(refusal.value)) < 3000
    assert "\n" not in str(refusal.value)


def test_a_name_that_occurs_twice_among_many_costs_nothing(run: Record, tmp_path: Path) -> None:
    run["settings"]["unknown"] = "here"
    forged = store(tmp_path / "run.json", run)
    names = b",".join(b'"%d": 0' % number for number in range(60_000))
    forged.write_bytes(forged.read_bytes().replace(b'"here"', b"{" + names + b', "59999": 1}'))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_utime
    with pytest.raises(Refusal, match=r"run\.json: not strict JSON: the member '59999' occurs twice"):
        examine(forged)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_utime - before < 5


def test_nesting_that_no_parser_follows_is_refused(run: Record, tmp_path: Path) -> None:
    run["settings"]["unknown"] = "here"
    forged = store(tmp_path / "run.json", run)
    forged.write_bytes(forged.read_bytes().replace(b'"here"', b"[" * 200_000 + b"]" * 200_000))
    with pytest.raises(Refusal, match=r"run\.json: not strict JSON: nested too deeply"):
        examine(forged)


def a_long_name(run: Record) -> None:
    run["items"][0]["id"] = "x" * 10**6


def times_of_any_size(run: Record) -> None:
    for sample, time in zip(run["items"][0]["samples"], (5e-324, 1.7e308), strict=True):
        sample["duration_ms"] = time


def many_findings(run: Record) -> None:
    told = {"code": "wrong_value", "message": "m" * 1000, "evidence": "e" * 1000, "strength": "MUST", "cause": None}
    findings = [{**told, "requirement": f"XX-{number}"} for number in range(1000)]
    run["items"][0].update(status="FAIL", findings=findings)


@pytest.mark.long
@pytest.mark.parametrize("change", [many_images, deep_values, a_long_name, times_of_any_size, many_findings])
def test_reports_of_any_record_end_soon_and_in_a_sentence(
    run: Record, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Callable[[Record], None]
) -> None:
    change(run)
    forged = str(store(tmp_path / "run.json", run))
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    for files in ([forged], [forged, forged]):
        code = main(["report", *files, "--out", str(tmp_path / "out")])
        told = capsys.readouterr()
        if code == 0:
            assert told.err == ""
        else:
            assert (code, told.out) == (3, "")
            assert re.fullmatch(
                r"otmcp: .* was not written: .*; if `otmcp verify` accepts the record, this is a fault of the kit.*\n",
                told.err,
            )
        assert len(told.out + told.err) < 9000
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before < 20


# -- files that are none --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["verify", "report"])
def test_files_that_are_larger_than_any_are_not_read(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    large = tmp_path / "large.json"
    with large.open("wb") as file:
        file.truncate(1 << 42)
    for files in ([large], [large, path], [path, large]):
        assert main([command, *map(str, files)]) == 1
        assert re.fullmatch(r"otmcp: refused: \S+large\.json has \d+ bytes, more than \d+\n", capsys.readouterr().err)


@pytest.mark.parametrize("command", ["verify", "report"])
def test_what_is_no_file_is_not_opened(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "nowhere").symlink_to(tmp_path / "none")
    no_file, nothing = "this is no regular file", "there is no such file"
    folder = "this is a folder and no regular file; name the file in it"
    others = {tmp_path / "pipe": no_file, tmp_path: folder, Path("/dev/zero"): no_file, tmp_path / "nowhere": nothing}
    for other, why in others.items():
        for files in ([other], [other, path], [path, other]):
            assert main([command, *map(str, files)]) == 2
            assert capsys.readouterr().err == f"otmcp: {other}: {why}\n"


# -- a terminal -----------------------------------------------------------------------------------------------------------

HOSTILE = "\x1b[2J\x1b[H\u202e\nverified: by TUV\r\n::error::\x07"


Shown = pytest.CaptureFixture[str]


def refused(shown: Shown, *files: Path) -> str:
    assert main(["verify", *map(str, files)]) == 1
    told = shown.readouterr()
    assert told.out == ""
    assert not TERMINAL.search(told.err)
    assert told.err.startswith("otmcp: refused: ")
    assert told.err.count("\n") == 1
    return told.err


def test_nothing_of_a_record_is_printed_as_it_is(run: Record, tmp_path: Path, capsys: Shown) -> None:
    run["items"][0].update(title=HOSTILE)
    assert "by TUV" in refused(capsys, store(tmp_path / "run.json", run))


def test_nothing_of_a_certificate_is_printed_as_it_is(path: Path, tmp_path: Path, capsys: Shown) -> None:
    certificate = tmp_path / "certificate.json"
    name = json.dumps(HOSTILE)
    certificate.write_text(f"{{{name}: 1, {name}: 2}}")
    assert "by TUV" in refused(capsys, certificate, path)


def test_a_name_of_marks_is_printed_without_them(run: Record, tmp_path: Path, capsys: Shown) -> None:
    run["subject"]["name"] = "acme \u202egnitset"
    assert main(["verify", str(store(tmp_path / "run.json", run))]) == 1
    told = capsys.readouterr().out
    assert told.startswith("verified: acme \\u202egnitset 0.1.0 is INCOMPLETE; ")
    assert not TERMINAL.search(told)


def test_nothing_of_a_record_is_printed_as_it_is_with_its_reports(run: Record, tmp_path: Path, capsys: Shown) -> None:
    run["subject"].update(name="acme \u202egnitset")
    run["items"][0].update(id=HOSTILE)
    other = store(tmp_path / "other.json", run)
    run["items"][0].update(status="FAIL")
    forged = store(tmp_path / "run.json", run)
    assert main(["report", str(forged), str(other), "--out", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "acme \\u202egnitset" in told
    assert "by TUV" in told
    assert not TERMINAL.search(told)
