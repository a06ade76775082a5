"""``otmcp self-check`` as a shell sees it."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from pytest_otmcp.reference_adapters.defects.listing import listing

from pytest_otmcp import cli
from pytest_otmcp.core.verdict import ExitCode
from pytest_otmcp.soundness import defect as defects
from pytest_otmcp.soundness.defect import Declared, read

from .command import OTMCP, otmcp, sentence
from .vendor import PATIENCE_S

KNOWN = read(listing())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(("--all", "MU-13"), "name none beside it"), (("-n", "0"), "expected 1 to 64"), (("-n", "all"), "expected 1 to")],
)
def test_options_that_mean_nothing_end_in_a_sentence(
    arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["self-check", *arguments]) == ExitCode.USAGE
    told = capsys.readouterr()
    assert words in told.err
    assert told.out == ""


@pytest.mark.long
def test_a_defect_that_does_not_exist_ends_in_a_sentence(tmp_path: Path) -> None:
    done = otmcp("self-check", "MU-9999", cwd=tmp_path)
    assert done.returncode == ExitCode.USAGE
    assert "no defect and no area 'MU-9999'" in sentence(done)


@pytest.mark.long
def test_defects_whose_library_is_missing_are_left_out_with_the_extra_that_brings_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("pytest_otmcp.subject.selection._is_installed", lambda name: name != "python-snap7")
    advice = "S7comm: python-snap7 is not installed; pip install 'pytest-otmcp[s7]'"
    without = next(one.id for one in KNOWN.defects if one.protocol == "s7")
    assert cli.main(["self-check", without]) == ExitCode.USAGE
    assert capsys.readouterr().err == f"otmcp: {advice}\n"
    assert cli.main(["self-check", "MU-02w", without, "-n", "1"]) == ExitCode.CONFORMANT
    told = capsys.readouterr()
    assert told.err == f"1 defect left out, {advice}\n"
    assert "noticed by exactly what must notice them: 1 of 1" in told.out


@pytest.mark.weekly
@pytest.mark.long
def test_doctor_names_the_library_that_a_further_reference_adapter_lacks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pytest_otmcp.subject.selection._is_installed", lambda name: name != "python-snap7")
    assert cli.main(["doctor"]) == ExitCode.CONFORMANT
    lines = capsys.readouterr().out.splitlines()
    assert lines[-2] == "S7comm: python-snap7 is not installed; pip install 'pytest-otmcp[s7]'"
    assert lines[-1].startswith("all is well")


@pytest.mark.long
def test_a_defect_that_nothing_notices_is_named_and_the_exit_code_is_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def declared() -> Declared:
        # Checks of another area are run, and none of them looks at what this defect does.
        moved = [replace(one, areas=("res",)) if one.id == "MU-02w" else one for one in KNOWN.defects]
        return replace(KNOWN, defects=tuple(moved))

    monkeypatch.setattr(defects, "declared", declared)
    assert cli.main(["self-check", "MU-02w", "MU-13", "-n", "1"]) == ExitCode.NOT_CONFORMANT
    told = capsys.readouterr().out
    assert "MU-02w     NOT NOTICED" in told
    assert "must be by WR-001.modbus" in told
    assert "MU-13      noticed" in told
    assert "noticed by exactly what must notice them: 1 of 2" in told
    assert told.splitlines()[-1] == "not as expected: MU-02w"


@pytest.mark.long
def test_ctrl_c_leaves_nothing_running(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()
    command = [*OTMCP, "self-check", "MU-13", "-n", "1"]
    with subprocess.Popen(command, cwd=tmp_path, stdin=theirs, stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        # The moving line is drawn again and again, so every line is a moment to look.
        shown = terminal(ours)
        for text in shown:
            started = psutil.Process(process.pid).children(recursive=True)
            if "under way: MU-13" in text and any("MU-13" in words(one) for one in started):
                break
        process.send_signal(signal.SIGINT)
        rest = "".join(shown)
        assert process.wait(PATIENCE_S) == ExitCode.USAGE
    os.close(ours)
    assert "otmcp: interrupted" in rest
    assert "Traceback" not in rest
    assert psutil.wait_procs(started, timeout=PATIENCE_S)[1] == []


def terminal(descriptor: int) -> Iterator[str]:
    """Yield what is written to the other end of a pseudo terminal, until everybody has closed it."""
    while True:
        try:
            text = os.read(descriptor, 65536)
        except OSError:
            return
        yield text.decode()


def words(process: psutil.Process) -> list[str]:
    """Return the command line of a process; none of one that has ended."""
    try:
        return process.cmdline()
    except psutil.NoSuchProcess:
        return []


@pytest.mark.long
def test_the_document_of_json_is_all_that_is_printed(tmp_path: Path) -> None:
    done = otmcp("self-check", "MU-13", "-n", "1", "--json", cwd=tmp_path)
    assert done.returncode == ExitCode.CONFORMANT, done.stderr
    document = json.loads(done.stdout)
    [entry] = document["defects"]
    assert entry["id"] == "MU-13"
    assert entry["as_expected"]
    assert entry["seen"] == entry["expected"] == {"items": ["MCP-004.modbus"], "requirements": ["MCP-004"]}
