"""The command ``otmcp`` as a shell sees it: its output, the files that it writes, its exit code."""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest

import pytest_otmcp
from pytest_otmcp import __version__, cli
from pytest_otmcp.errors import KitError, UsageError
from pytest_otmcp.record import load
from pytest_otmcp.suite.catalogue import kit_digest
from tests.stored_runs import store
from tests.unit.certified import conformant_run

from .command import OTMCP, otmcp, sentence
from .vendor import PATIENCE_S, WAITING, Repository, port_of

SAMPLE = Path(__file__).parents[2] / "reports" / "sample" / "run.json"

SILENT = """
[subject]
name = "silent"
version = "1"

[adapter.modbus]
command = ["{python}", "-c", "raise SystemExit(3)"]
"""


# -- the command line -------------------------------------------------------------------------------------------


def test_help_names_every_command_and_imports_nothing_heavy(tmp_path: Path) -> None:
    program = (
        "import sys\n"
        "from pytest_otmcp.cli import main\n"
        "assert main(['--help']) == 0\n"
        "heavy = {'pytest', 'mcp', 'pymodbus', 'asyncua', 'paho', 'scipy', 'matplotlib', 'jsonschema'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for command in ("init", "doctor", "certify", "verify", "explain", "report", "mock", "self-check"):
        assert re.search(rf"^ +{command}\b", done.stdout, re.MULTILINE)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["certfy"], "invalid choice: 'certfy'"),
        (["certify", "--reps", "many"], "--reps: invalid int value: 'many'"),
        (["certify", "--reps", "29"], "--reps: a certificate needs at least 30 repetitions, found 29"),
        (["certify", "--subject", "nowhere.toml"], "nowhere.toml: there is no such"),
        (["certify", "--subject", "broken.toml"], "broken.toml: not valid TOML"),
        (["certify", "--out", "broken.toml"], "broken.toml"),
        (["verify", "nowhere.json", "nowhere.json"], "nowhere.json: there is no such file"),
        (["report", "nowhere.json"], "nowhere.json: there is no such file"),
        (["mock", "hart"], "invalid choice: 'hart'"),
        (["mock", "modbus", "--port", "70000"], "--port: expected 0 to 65535, found '70000'"),
        (["mock", "modbus", "--broker", "mqtt://127.0.0.1"], "--broker: the modbus mock has no such option"),
        (["mock", "sparkplug"], "the sparkplug mock needs --broker URL"),
        (
            ["mock", "sparkplug", "--broker", "mqtt://127.0.0.1", "--port", "1"],
            "--port: the sparkplug mock has no such",
        ),
        (["mock", "modbus", "--port", "many"], "--port: expected 0 to 65535, found 'many'"),
    ],
)
def test_what_cannot_be_done_is_said_in_a_sentence_and_ends_with_2(
    tmp_path: Path, arguments: list[str], words: str
) -> None:
    (tmp_path / "broken.toml").write_text("[subject\n")
    done = otmcp(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert "a JSON line says" not in done.stderr


def test_without_a_command_all_are_listed_with_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 2
    shown = capsys.readouterr().err
    for command in ("init", "doctor", "call", "certify", "verify", "explain", "report", "mock", "docs"):
        assert re.search(rf"^ +{command} +\w.*$", shown, re.MULTILINE)


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"pytest-otmcp {pytest_otmcp.__version__}\n"


def test_the_pages_of_the_documentation_are_listed_and_printed(capsys: pytest.CaptureFixture[str]) -> None:
    docs = Path(__file__).parents[2] / "docs"
    assert cli.main(["docs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines} >= {path.stem for path in docs.glob("*.md")}
    assert any(re.fullmatch(r"items +The items", line) for line in lines)
    assert any(re.fullmatch(r"subject-file +The subject file", line) for line in lines)
    for name in ("subject-file", "docs/subject-file.md"):
        assert cli.main(["docs", name]) == 0
        assert capsys.readouterr().out == (docs / "subject-file.md").read_text()
    typescript = "first-adapter/typescript"
    for name in (
        "first-adapter/modbus.py",
        "docs/first-adapter/first/modbus.toml",
        f"{typescript}/tools.ts",
        f"{typescript}/modbus/adapter.ts",
    ):
        assert cli.main(["docs", name]) == 0
        assert capsys.readouterr().out == (docs / name.removeprefix("docs/")).read_text()
    assert cli.main(["docs", "subjectfile"]) == 2
    assert capsys.readouterr().err == "otmcp: there is no page 'subjectfile'; did you mean 'subject-file'?\n"


def test_a_part_of_a_page_is_printed_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["docs", "by-library#pymodbus"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("## pymodbus ")
    assert "## paho-mqtt" not in told
    for name, refusal in (
        ("by-library#pymodbs", "there is no part of by-library 'pymodbs'; did you mean 'pymodbus'?"),
        ("quickstart#x", "there is no page 'quickstart'; known are "),
        (
            "subject-file#x",
            "the page subject-file has no parts that can be asked for: 'otmcp docs subject-file' prints it",
        ),
    ):
        assert cli.main(["docs", name]) == 2
        assert capsys.readouterr().err.startswith(f"otmcp: {refusal}")


@pytest.mark.parametrize("module", ["pytest_otmcp", "pytest_otmcp.cli", "pytest_otmcp.plugin"])
def test_on_another_system_the_import_ends_in_one_sentence(tmp_path: Path, module: str) -> None:
    program = f"import sys; sys.platform = 'win32'; import {module}"
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("pytest-otmcp runs on Linux, not on win32: on Windows use WSL 2")
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (UsageError("x.toml: no"), 2, "otmcp: x.toml: no"),
        (cli.Refusal("no certificate: M1\nfailed"), 1, "otmcp: no certificate: M1 failed"),
        (KitError("the mock died"), 3, "otmcp: the mock died (a fault of the kit; please file a bug)"),
        (KeyboardInterrupt(), 2, "otmcp: interrupted"),
        (
            OSError(28, "No space left on device", "out/run.json"),
            3,
            "otmcp: out/run.json: the disk is full; make room, ",
        ),
        (OSError(13, "Permission denied", "out/run.json"), 2, "otmcp: out/run.json: Permission denied"),
        (ZeroDivisionError("division"), 3, "otmcp: a fault of the kit at test_cli.py:"),
    ],
)
def test_every_error_is_one_sentence_with_its_exit_code(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    words: str,
) -> None:
    def fail(_arguments: Any) -> int:
        raise error

    monkeypatch.setattr("pytest_otmcp.cli.report.run", fail)
    assert cli.main(["report", "run.json"]) == code
    told = capsys.readouterr().err
    assert told.startswith(words)
    assert told.count("\n") == 1


def test_a_reader_that_went_away_is_no_traceback(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [*OTMCP, "--help"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    with process.stderr:
        assert process.stderr.read() == ""
    process.wait(30)


# -- mock -------------------------------------------------------------------------------------------------------


def test_a_mock_serves_until_its_input_closes_whatever_lies_in_the_directory(tmp_path: Path) -> None:
    (tmp_path / "asyncio.py").write_text("raise SystemExit('a module of the directory was imported')")
    with subprocess.Popen(
        [*OTMCP, "mock", "modbus"],
        cwd=tmp_path,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        ready = json.loads(process.stdout.readline())
        assert ready["protocol"] == "modbus"
        with socket.create_connection(("127.0.0.1", ready["port"]), timeout=5) as connection:
            # Read holding register 0 of unit 1.
            connection.sendall(bytes.fromhex("000100000006010300000001"))
            assert connection.recv(100)[:8] == bytes.fromhex("0001000000050103")
        process.stdin.close()
        assert process.wait(30) == 0
        assert "for a Modbus TCP client with unit identifier 1" in process.stderr.read()


# -- report -----------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_reports_are_made_again_without_measuring(tmp_path: Path) -> None:
    done = otmcp("report", str(SAMPLE), "--out", "again", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {"said": [f"the reports of {SAMPLE} are in again"]}
    made = {str(path.relative_to(tmp_path / "again")) for path in (tmp_path / "again").rglob("*.*")}
    assert {"tables/tab_results.tex", "figures/latency_boxplot.pdf", "report.html", "summary.md"} <= made


@pytest.mark.long
def test_a_report_that_cannot_be_made_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out" / "summary.md" / "in the way").mkdir(parents=True)
    assert cli.main(["report", str(SAMPLE), "--out", str(tmp_path / "out")]) == 2
    wanted = f"otmcp: {tmp_path / 'out' / 'summary.md'} was not written: Is a directory\n"
    assert capsys.readouterr().err == wanted
    assert (tmp_path / "out" / "report.html").is_file()


def test_no_report_is_made_from_a_record_that_was_edited(tmp_path: Path) -> None:
    edited = tmp_path / "run.json"
    edited.write_text(SAMPLE.read_text().replace('"repetition":3', '"repetition":4', 1))
    done = otmcp("report", "run.json", cwd=tmp_path)
    assert done.returncode == 1
    assert sentence(done).startswith("otmcp: no reports: ")
    assert os.listdir(tmp_path) == ["run.json"]


# -- verify -----------------------------------------------------------------------------------------------------


def test_a_record_of_another_commit_is_refused_in_words_that_accuse_nobody(capsys: pytest.CaptureFixture[str]) -> None:
    code = cli.main(["verify", str(SAMPLE)])
    told = capsys.readouterr()
    if load(SAMPLE)["kit"]["digest"] == kit_digest():
        assert told.out.startswith("verified: ")
        return
    assert code == 1
    assert told.err == (
        f"otmcp: refused: {SAMPLE} was judged by another kit: a pytest-otmcp {__version__} with other files than this one (of another "
        "commit, or one of the two has been changed); only that kit can verify it; `otmcp report` shows what the record says, "
        "`otmcp judge` what this kit finds otherwise\n"
    )


# -- certify ----------------------------------------------------------------------------------------------------


def test_known_deviations_forbid_a_certificate_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "otmcp.toml").write_text(
        SILENT + '\n[[deviation]]\nitem = "FM1"\nreason = "fixed in 2.0"\nexpires = 2099-01-01\n'
    )
    older = tmp_path / "reports" / "certificate" / "certificate.json"
    older.parent.mkdir(parents=True)
    for name in ("certificate.json", "summary.md", "verdict.json", "report.html"):
        (older.parent / name).write_text("of an earlier version")
    done = otmcp("certify", cwd=tmp_path)
    assert done.returncode == 1
    assert "declares known deviations (FM1), and a certificate excuses nothing" in sentence(done)
    assert os.listdir(older.parent) == []


def test_a_subject_file_that_cannot_be_read_leaves_no_certificate_of_an_earlier_run(tmp_path: Path) -> None:
    (tmp_path / "otmcp.toml").write_text("[subject")
    older = tmp_path / "reports" / "certificate" / "badge.svg"
    older.parent.mkdir(parents=True)
    older.write_text("of an earlier version")
    assert otmcp("certify", cwd=tmp_path).returncode == 2
    assert os.listdir(older.parent) == []


def test_who_writes_and_claims_no_guard_is_told_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "otmcp.toml").write_text(SILENT + 'unclaimed = { guard = "has no read-only mode" }\n')
    done = otmcp("certify", cwd=tmp_path)
    assert done.returncode == 1
    assert sentence(done) == (
        "otmcp: no certificate: modbus: it writes, and that its writes can be disabled (guard, requirement WR-004) "
        "is not claimed: has no read-only mode"
    )
    assert not (tmp_path / "reports").exists()


@pytest.mark.long
def test_what_fails_gets_no_certificate_and_keeps_no_older_one(tmp_path: Path) -> None:
    (tmp_path / "otmcp.toml").write_text(SILENT)
    (tmp_path / "out").mkdir()
    for name in ("certificate.json", "badge.json", "badge.svg"):
        (tmp_path / "out" / name).write_text("of an earlier version")
    done = otmcp("certify", "--out", "out", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert "VERDICT: NOT CONFORMANT" in done.stdout
    assert sentence(done).startswith(
        "otmcp: no certificate: the verdict is NOT CONFORMANT: the adapter exited with code 3 during its handshake"
    )
    left = set(os.listdir(tmp_path / "out"))
    assert "run.json" in left
    assert not left & {"certificate.json", "badge.json", "badge.svg"}


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.long
def test_an_interrupted_certification_leaves_a_record_and_nothing_running(
    empty_repository: Repository, waiting: socket.socket, number: signal.Signals
) -> None:
    # The warm-up makes the first call; the adapter waits in the second.
    empty_repository.subject("read_input_registers", "2", port_of(waiting), program=WAITING)
    process = subprocess.Popen(
        [*OTMCP, "certify"], cwd=empty_repository.root, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    with process:
        try:
            connection, _ = waiting.accept()
            with connection:
                started = psutil.Process(process.pid).children(recursive=True)
                assert started
                process.send_signal(number)
                told, complaints = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
    assert process.returncode == 2, told + complaints
    assert re.search(r"^  M1 +30/30", told, re.MULTILINE)
    assert complaints.endswith("otmcp: interrupted\n")
    assert psutil.wait_procs(started, timeout=PATIENCE_S)[1] == []
    out = empty_repository.root / "reports" / "certificate"
    assert load(out / "run.json", allow_incomplete=True)["footer"]["complete"] is False
    assert not (out / "certificate.json").exists()


def concluded(record: dict[str, Any] | None, ended: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """Return the exit code of a certification whose suite left this record."""

    def suite(_subject: Path | None, out: Path, *_options: str) -> int:
        if record is not None:
            store(out / "run.json", record)
        return ended

    monkeypatch.setattr("pytest_otmcp.cli.certify.run_suite", suite)
    return cli.main(["certify", "--out", str(tmp_path)])


@pytest.mark.parametrize(
    ("statuses", "ended", "code", "words"),
    [
        (None, 2, 2, "no certificate: the suite did not begin, for the reason above"),
        (None, 4, 2, "no certificate: the suite did not begin, for the reason above"),
        (None, 3, 3, "no certificate: pytest ended with 3 before anything was recorded (a fault of the kit"),
        (None, 5, 3, "no certificate: pytest ended with 5 before anything was recorded (a fault of the kit"),
        ({"M1": "FAIL"}, 1, 1, "no certificate: the verdict is NOT CONFORMANT: M1 did not pass"),
        ({"M1": "KIT_ERROR"}, 3, 3, "no certificate: the verdict is INDETERMINATE: M1 did not pass"),
        ({"M1": "KIT_ERROR", "M2": "FAIL"}, 3, 3, "no certificate: the verdict is INDETERMINATE: M1, M2 did not pass"),
        ({"M2": "NOT_APPLICABLE"}, 0, 1, "no certificate: M2 is called NOT_APPLICABLE"),
    ],
)
def test_without_a_certificate_the_exit_code_says_whose_fault_it_is(
    statuses: dict[str, str] | None,
    ended: int,
    code: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    record = None if statuses is None else conformant_run()
    for entry in record["items"] if record is not None else ():
        entry["status"] = statuses.get(entry["id"], entry["status"])
    if record is not None and ended:
        record["footer"]["verdict"] = "NOT CONFORMANT"
    assert concluded(record, ended, tmp_path, monkeypatch) == code
    assert capsys.readouterr().err.startswith(f"otmcp: {words}")
    assert not (tmp_path / "certificate.json").exists()


def test_a_run_that_was_narrowed_although_it_was_isolated_gets_no_certificate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record = conformant_run()
    record["settings"]["narrowed"] = ["files of the installed kit were changed: oracle.py"]
    assert concluded(record, 0, tmp_path, monkeypatch) == 1
    assert "the suite was narrowed: files of the installed kit were changed: oracle.py" in capsys.readouterr().err


def test_what_is_not_claimed_is_printed_with_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert concluded(conformant_run(), 0, tmp_path, monkeypatch) == 0
    told = capsys.readouterr().out
    assert "modbus: not claimed: ping (it has no such tool)" in told
    assert "mqtt" not in told
    assert {"certificate.json", "badge.json", "badge.svg"} <= set(os.listdir(tmp_path))
    assert 'It has earned a <a href="certificate.html">certificate</a>.' in (tmp_path / "report.html").read_text()
    digest = hashlib.sha256((tmp_path / "certificate.json").read_bytes()).hexdigest()
    assert digest in (tmp_path / "certificate.html").read_text()
