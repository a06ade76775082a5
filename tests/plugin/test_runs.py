"""The plugin as its users see it: real runs of the shipped suite in a pytest of their own."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from pytest_otmcp.record.run_file import load

SUITE = ["--pyargs", "pytest_otmcp.conformance"]
PYTEST = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]
DEFECTIVE = Path(__file__).parents[1] / "soundness" / "defective.py"

Run = Callable[..., subprocess.CompletedProcess[str]]

ALTERED = """
[subject]
name = "altered"
version = "1"

[adapter.modbus]
command = ["{{python}}", "{program}", "{mode}"]
env = {{ MODBUS_HOST = "{{host}}", MODBUS_PORT = "{{port}}", MODBUS_TIMEOUT_S = "20", MODBUS_DEADLINE_S = "25" }}
rw = {{ env = {{ MODBUS_WRITES_ENABLED = "true" }} }}
deadline_s = 30
"""


@pytest.fixture
def run(tmp_path: Path) -> Run:
    def start(*options: str) -> subprocess.CompletedProcess[str]:
        command = [*PYTEST, *SUITE, "--otmcp-report-dir", str(tmp_path / "report"), *options]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)

    return start


def offspring(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """What a run has started, to be looked at when the run is over and nobody's child any more."""
    started = psutil.Process(process.pid).children(recursive=True)
    assert started
    return started


def nothing_is_left(started: list[psutil.Process]) -> bool:
    return not psutil.wait_procs(started, timeout=60)[1]


def test_a_narrowed_run_is_recorded_and_called_incomplete(run: Run, tmp_path: Path) -> None:
    done = run("-k", "normal and M2 or FM1", "--otmcp-reps=4", "--junit-xml=junit.xml")
    assert done.returncode == 1, done.stdout
    assert "VERDICT: INCOMPLETE (8/8 runs passed in 2 items; 36 of 38 items did not run" in done.stdout
    record = load(tmp_path / "report" / "run.json", allow_incomplete=True)
    assert [item["id"] for item in record["items"]] == ["M2", "FM1"]
    assert record["settings"]["repetitions"] == {"normal": 4, "fault": 4, "stress": 2, "recovery": 3}
    sample = record["items"][0]["samples"][0]
    assert sample["calls"][0]["tool"] == "read_input_registers"
    assert {entry["kind"] for entry in sample["device"]} == {"request", "response"}
    assert (tmp_path / "report" / "tables" / "tab_results.tex").is_file()
    assert (tmp_path / "report" / "figures" / "latency_boxplot.pdf").is_file()
    names = [case.get("name") for case in ElementTree.parse(tmp_path / "junit.xml").iter("testcase")]
    assert names == ["test_normal[M2]", "test_fault[FM1]"]


def test_xdist_gives_the_same_items_and_withholds_latencies(run: Run, tmp_path: Path) -> None:
    done = run("-n", "2", "--otmcp-suite=fault", "--otmcp-reps=2")
    assert done.returncode == 1, done.stdout
    record = load(tmp_path / "report" / "run.json", allow_incomplete=True)
    assert [item["id"] for item in record["items"]] == ["FM1", "FM2", "FQ1", "FQ2", "FO1", "FO2", "FX1"]
    assert {item["status"] for item in record["items"]} == {"PASS"}
    assert record["footer"]["timing_valid"] is False
    assert "latencies withheld" in done.stdout
    assert set(record["subject"]["adapters"]) == {"modbus", "mqtt", "opcua"}


def test_a_defective_adapter_makes_the_run_fail_with_a_finding(run: Run, tmp_path: Path) -> None:
    subject = tmp_path / "altered.toml"
    subject.write_text(ALTERED.format(program=DEFECTIVE, mode="wrong-value"))
    done = run("-k", "M1 or M2", "--otmcp-reps=2", "--otmcp-subject", str(subject))
    assert done.returncode == 1
    assert "VERDICT: NOT CONFORMANT" in done.stdout
    assert "rep 1/2: read_input_registers(address=0, count=4): values should be" in done.stdout
    assert "Traceback" not in done.stdout


def test_a_protocol_that_is_not_claimed_is_not_applicable(run: Run, tmp_path: Path) -> None:
    subject = tmp_path / "altered.toml"
    subject.write_text(ALTERED.format(program=DEFECTIVE, mode="none"))
    done = run("-k", "normal and (M1 or Q1)", "--otmcp-reps=1", "--otmcp-subject", str(subject))
    assert done.returncode == 1, done.stdout
    record = load(tmp_path / "report" / "run.json", allow_incomplete=True)
    assert {item["id"]: item["status"] for item in record["items"]} == {"M1": "PASS", "Q1": "NOT_APPLICABLE"}


def test_an_interrupted_run_keeps_what_it_measured(tmp_path: Path) -> None:
    report = tmp_path / "report"
    command = [
        *PYTEST,
        *SUITE,
        "--otmcp-report-dir",
        str(report),
        "--otmcp-reps=2000",
        # As on a terminal: the moving line tells which repetition begins.
        "--color=yes",
        "-k",
        "normal and (M1 or M2 or M3)",
    ]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        # A carriage return ends a line here, too. The second repetition of M3 has begun, so the first is over.
        if re.match(r"  M3 +[1-9]\d*/2000 ", line):
            break
    started = offspring(process)
    process.send_signal(signal.SIGINT)
    rest = process.stdout.read()
    process.stdout.close()
    assert process.wait(120) == pytest.ExitCode.INTERRUPTED, rest
    assert "VERDICT: INCOMPLETE" in rest
    record = load(report / "run.json", allow_incomplete=True)
    assert record["footer"]["complete"] is False
    assert record["footer"]["reason"] == "interrupted by the user"
    items = {item["id"]: item for item in record["items"]}
    assert [len(items[name]["samples"]) for name in ("M1", "M2")] == [2000, 2000]
    assert items["M3"]["status"] == "INTERRUPTED"
    assert nothing_is_left(started)


def test_progress_on_a_terminal_moves_and_stays_within_its_edges(tmp_path: Path) -> None:
    columns = 90
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    command = [*PYTEST, *SUITE, "--otmcp-report-dir", str(tmp_path / "report"), "--otmcp-reps=300", "-k", "M1 or M4"]
    # COLUMNS in the environment would win over what the terminal says.
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "NO_COLOR", "CI")}
    with subprocess.Popen(command, cwd=tmp_path, stdout=theirs, stderr=theirs, env=environment | {"TERM": "xterm"}):
        os.close(theirs)
        told = b""
        # Linux answers EIO when nobody holds the other end any more.
        with contextlib.suppress(OSError):
            while chunk := os.read(ours, 65536):
                told += chunk
    os.close(ours)
    text = re.sub(r"\x1b\[[0-9;]*m", "", told.decode())
    assert re.search(r"\r  M1 +\d+/300   item 1 of 3, about", text), text
    parts = [part for line in text.split("\n") for part in line.rstrip("\r").split("\r")]
    drawn = [part for part in parts if part.startswith(("  M1 ", "  M4 "))]
    assert max(map(len, drawn)) <= columns
    (last,) = (line for line in drawn if "%]" in line)
    assert len(last) >= columns - 2


def test_a_run_that_is_interrupted_while_an_adapter_starts_leaves_nothing_running(tmp_path: Path) -> None:
    silent = 'import pathlib, sys\npathlib.Path("started").touch()\nsys.stdin.read()\n'
    (tmp_path / "silent.py").write_text(silent)
    (tmp_path / "otmcp.toml").write_text(
        '[subject]\nname = "silent"\nversion = "1"\n'
        '[adapter.modbus]\ncommand = ["{python}", "{dir}/silent.py"]\nunclaimed = { guard = "says nothing" }\n'
    )
    process = subprocess.Popen(
        [*PYTEST, *SUITE, "--otmcp-reps=1", f"--otmcp-subject={tmp_path / 'otmcp.toml'}"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    while not (tmp_path / "started").exists():
        assert process.poll() is None
        time.sleep(0.02)
    started = offspring(process)
    process.send_signal(signal.SIGINT)
    told, _ = process.communicate(timeout=120)
    assert process.returncode == pytest.ExitCode.INTERRUPTED, told
    assert "Traceback" not in told
    assert nothing_is_left(started)


def test_a_mock_that_dies_is_the_kits_fault(tmp_path: Path) -> None:
    report = tmp_path / "report"
    command = [
        *PYTEST,
        *SUITE,
        "--otmcp-report-dir",
        str(report),
        "--otmcp-reps=3000",
        "-k",
        "normal and (M1 or M2 or M3)",
    ]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if "3000/3000" in line:
            break
    mocks = [
        child
        for child in psutil.Process(process.pid).children(recursive=True)
        if "pytest_otmcp.mocks" in " ".join(child.cmdline())
    ]
    for mock in mocks:
        # A device follows its launcher by itself.
        with contextlib.suppress(psutil.NoSuchProcess):
            mock.kill()
    rest = process.stdout.read()
    process.stdout.close()
    assert process.wait(120) == 3, rest
    assert "VERDICT: INDETERMINATE" in rest
    assert "please file a bug" in rest


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--otmcp-reps=many"], "--otmcp-reps: expected a whole number, found 'many'"),
        (["--otmcp-reps=0"], "--otmcp-reps: expected 1 to 100000, found 0"),
        (["--otmcp-suite=falt"], "--otmcp-suite: 'falt' is unknown; did you mean 'fault'?"),
        (["--otmcp-era=stone"], "--otmcp-era: 'stone' is unknown"),
        (["--otmcp-time-scale=fast"], "--otmcp-time-scale: expected a number, found 'fast'"),
        (["--otmcp-broker=http://x"], "--otmcp-broker: expected mqtt://host:port, found 'http://x'"),
        (["--otmcp-subject=nowhere.toml"], "there is no such file"),
        (["--otmcp-subject=broken.toml"], "not valid TOML"),
        (["--otmcp-subject=typo.toml"], "adapter.modbuss: unknown key; did you mean 'modbus'?"),
    ],
)
def test_a_bad_option_or_file_is_one_clear_sentence(
    run: Run, tmp_path: Path, options: list[str], sentence: str
) -> None:
    (tmp_path / "broken.toml").write_text("[subject\n")
    (tmp_path / "typo.toml").write_text('[subject]\nname="x"\nversion="1"\n[adapter.modbuss]\ncommand=["x"]\n')
    done = run(*options)
    assert done.returncode == 2
    output = done.stdout + done.stderr
    assert sentence in output
    assert "Traceback" not in output


def test_the_plugin_is_inert_where_nothing_of_it_is_collected(tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text(
        "import sys\n"
        "def test_own():\n"
        "    heavy = {'mcp', 'pymodbus', 'asyncua', 'paho', 'scipy', 'numpy', 'matplotlib', 'jmespath', 'jsonschema'}\n"
        "    heavy |= {'anyio', 'pydantic', 'google', 'jinja2', 'pytest_otmcp.trial.bench', 'pytest_otmcp.subject'}\n"
        "    assert not heavy & set(sys.modules)\n"
    )
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    command = [*PYTEST, "-p", "pytest_otmcp.plugin", "test_own.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stdout
    assert "VERDICT" not in done.stdout
    assert not (tmp_path / "reports").exists()


def test_the_record_is_plain_json(run: Run, tmp_path: Path) -> None:
    run("-k", "M1", "--otmcp-reps=1")
    record = json.loads((tmp_path / "report" / "run.json").read_text())
    assert record["schema"] == "otmcp-run/1"
