"""The plugin as its users see it: real runs of the shipped suite in a pytest of their own."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import pty
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import termios
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from operator import itemgetter
from pathlib import Path
from typing import Any

import psutil
import pytest

from pytest_otmcp.errors import UsageError
from pytest_otmcp.plugin.options import read_settings
from pytest_otmcp.soundness.warm_start import WarmStart

from .vendor import OUTSIDE, PATIENCE_S, WAITING, Outcome, Repository, port_of

SUITE = ("--pyargs", "pytest_otmcp.conformance")
HONEST = Path(__file__).parents[1] / "soundness" / "honest" / "adapter.py"

SILENT = """
import socket, sys

socket.create_connection(("127.0.0.1", int(sys.argv[1])))
sys.stdin.read()
"""


@pytest.fixture
def repository(empty_repository: Repository) -> Repository:
    """An empty repository."""
    return empty_repository


@pytest.fixture(scope="module")
def wrong_value(tmp_path_factory: pytest.TempPathFactory, warm_start: WarmStart) -> Outcome:
    """A run with an adapter for Modbus alone that reports wrong register values."""
    repository = Repository(tmp_path_factory.mktemp("wrong-value"), warm_start)
    repository.subject("wrong-value")
    return repository.pytest(*SUITE, "-k", "normal and (M1 or M2 or Q1)", "--otmcp-reps=2")


@pytest.mark.long
def test_a_narrowed_run_is_recorded_and_called_incomplete(repository: Repository) -> None:
    repository.reference_subject()
    options = ("-k", "normal and M2 or FM1", "--otmcp-reps=4", "--junit-xml=junit.xml")
    tables = repository.root / "reports" / "latest" / "tables"
    tables.mkdir(parents=True)
    outcome = repository.pytest(*SUITE, *options, plugins=None, drawn=True)
    assert outcome.code == 1, outcome.output
    assert (
        "VERDICT: INCOMPLETE (2 of 11 Modbus items passed; 8/8 runs passed; 36 of 38 items did not run"
        in outcome.output
    )
    record = outcome.record
    assert record["schema"] == "otmcp-run/3"
    assert [item["id"] for item in record["items"]] == ["M2", "FM1"]
    assert record["settings"]["repetitions"] == {"normal": 4, "fault": 4, "stress": 2, "recovery": 3, "requirements": 1}
    sample = record["items"][0]["samples"][0]
    assert sample["calls"][0]["tool"] == "read_input_registers"
    assert {entry["kind"] for entry in sample["device"]} == {"request", "response"}
    # Tables and figures compare items: whoever tries two of them does not wait for them, and none of an earlier run stays.
    assert {path.name for path in outcome.report.iterdir()} == {"run.json", "report.html", "summary.md", "verdict.json"}
    cases = ElementTree.parse(repository.root / "junit.xml").iter("testcase")
    # The last says that it was narrowed: a file without it would look like one of a run in which nothing is missing.
    assert [(case.get("classname"), case.get("name")) for case in cases] == [
        ("pytest_otmcp.conformance.test_normal", "test_normal[M2]"),
        ("pytest_otmcp.conformance.test_fault", "test_fault[FM1]"),
        ("otmcp", "run"),
    ]


def test_the_record_is_plain_json(wrong_value: Outcome) -> None:
    items = json.loads((wrong_value.report / "run.json").read_bytes())["items"]
    assert [item["id"] for item in items] == [item["id"] for item in wrong_value.record["items"]]


@pytest.mark.long
def test_a_warning_fails_nothing_and_stands_beside_the_verdict(repository: Repository) -> None:
    repository.subject("mcp/no-text-block", program=HONEST)
    outcome = repository.pytest(*SUITE, "-k", "normal and M1", "--otmcp-reps=2", "--junit-xml=junit.xml")
    assert outcome.statuses == {"M1": "PASS"}
    assert re.search(r"VERDICT: INCOMPLETE \(.*2/2 runs passed, 1 warning", outcome.output), outcome.output
    assert "MCP-006, 3 times in M1: ping(): the result has no text block" in outcome.output
    (case,) = ElementTree.parse(repository.root / "junit.xml").iter("testcase")
    properties = {entry.get("name"): entry.get("value") for entry in case.iter("property")}
    assert "the result has no text block" in (properties["otmcp_warning"] or "")
    for report in ("report.html", "summary.md"):
        assert "the result has no text block" in (outcome.report / report).read_text(encoding="utf-8")


@pytest.mark.long
def test_programs_read_verdict_rule_and_what_is_new_since_an_earlier_run(repository: Repository) -> None:
    repository.subject("none")
    options = ("-k", "normal and M2 or FM1", "--otmcp-reps=1", "--junit-xml=junit.xml")
    first = repository.pytest(*SUITE, *options)
    earlier = shutil.copy(first.report / "run.json", repository.root / "earlier.json")
    repository.subject("wrong-value")
    later = repository.pytest(*SUITE, *options, f"--otmcp-baseline={earlier}")
    assert "; since the baseline 1 new (RD-001 Modbus))" in later.output, later.output
    told = json.loads((later.report / "verdict.json").read_text())
    counted = {"of": 11, "passed": 1, "failed": 1, "unclaimed": 0}
    assert [(one["rule"], one["code"], one["items"]) for one in told["causes"]] == [("RD-001", "wrong_value", ["M2"])]
    assert (told["verdict"], told["items"], told["levels"]) == (later.verdict, {"Modbus": counted}, {})
    tree = ElementTree.parse(repository.root / "junit.xml")
    found = [(entry.get("name"), entry.get("value")) for entry in tree.iter("property")]
    assert found == [
        ("otmcp_verdict", later.verdict),
        ("otmcp_items", "1 of 11 Modbus items passed, 1 did not"),
        ("otmcp_catalogue", told["catalogue"]),
        ("otmcp_rule", "RD-001"),
    ]
    again = repository.pytest(*SUITE, *options, "--otmcp-baseline=reports/latest/run.json")
    assert "; since the baseline nothing has changed)" in again.output
    repository.subject("none")
    mended = repository.pytest(*SUITE, *options, "--otmcp-baseline=reports/latest/run.json")
    assert "; since the baseline 1 mended (RD-001 Modbus))" in mended.output


def test_a_defective_adapter_makes_the_run_fail_with_a_finding(wrong_value: Outcome) -> None:
    assert wrong_value.code == 1
    assert "VERDICT: NOT CONFORMANT" in wrong_value.output
    assert "read_input_registers(address=0, count=4): values should be" in " ".join(wrong_value.output.split())
    assert "Traceback" not in wrong_value.output


def test_a_protocol_that_is_not_claimed_is_not_applicable(wrong_value: Outcome) -> None:
    assert wrong_value.statuses == {"M1": "PASS", "M2": "FAIL", "Q1": "NOT_APPLICABLE"}


# -- runs in which something happens ------------------------------------------------------------------------------


@contextmanager
def started(repository: Repository, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Start a run of the suite; the run is killed at the end of the test, however the test ends."""
    process = subprocess.Popen(
        repository.command(*SUITE, *options),
        cwd=repository.root,
        env=repository.environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    with process:
        try:
            yield process
        finally:
            process.kill()


def descendants(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Return the processes that a run has started; they can be looked at after it, when they have another parent."""
    found = psutil.Process(process.pid).children(recursive=True)
    assert found
    return found


def all_end(processes: list[psutil.Process]) -> bool:
    """Wait for the end of the processes; tell whether all of them ended."""
    return not psutil.wait_procs(processes, timeout=PATIENCE_S)[1]


ENDINGS = ["SIGINT", *(pytest.param(name, marks=pytest.mark.long) for name in ("SIGTERM", "SIGHUP"))]
"""The signals that ask a run to end: Ctrl-C, ``docker stop``, a closed terminal."""


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("ending", ENDINGS)
def test_an_interrupted_run_keeps_what_it_measured(repository: Repository, waiting: socket.socket, ending: str) -> None:
    # The warm-up and the first repetition make a call each; the adapter waits in the third.
    repository.subject("write_register", "3", port_of(waiting), program=WAITING)
    with started(repository, "--otmcp-reps=3", "-k", "normal and (M1 or M2 or M3)") as process:
        connection, _ = waiting.accept()
        with connection:
            running = descendants(process)
            process.send_signal(signal.Signals[ending])
            output, _ = process.communicate(timeout=PATIENCE_S)
    outcome = repository.outcome(process.returncode, output)
    assert outcome.code == pytest.ExitCode.INTERRUPTED, output
    assert "VERDICT: INCOMPLETE" in output
    footer = outcome.record["footer"]
    assert footer["complete"] is False
    assert footer["reason"] == ("interrupted by the user" if ending == "SIGINT" else f"ended by {ending}")
    assert (outcome.report / "report.html").is_file()
    assert {item["id"]: len(item["samples"]) for item in outcome.record["items"]} == {"M1": 3, "M2": 3, "M3": 1}
    assert outcome.statuses["M3"] == "INTERRUPTED"
    assert all_end(running)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("ending", ["SIGINT", pytest.param("SIGTERM", marks=pytest.mark.long)])
@pytest.mark.long
def test_a_run_that_is_interrupted_while_an_adapter_starts_leaves_nothing_running(
    repository: Repository, waiting: socket.socket, ending: str
) -> None:
    repository.write(
        silent_py=SILENT,
        otmcp_toml='[subject]\nname = "silent"\nversion = "1"\n[adapter.modbus]\n'
        f'command = ["{{python}}", "{{dir}}/silent.py", "{port_of(waiting)}"]\nunclaimed = {{ guard = "says nothing" }}\n'
        f"{OUTSIDE}",
    )
    reports = repository.root / "reports" / "latest"
    reports.mkdir(parents=True)
    for name in ("run.json", "report.html", "verdict.json"):
        (reports / name).write_text("of an earlier run", encoding="utf-8")
    with started(repository, "--otmcp-reps=1") as process:
        connection, _ = waiting.accept()
        with connection:
            running = descendants(process)
            process.send_signal(signal.Signals[ending])
            output, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == pytest.ExitCode.INTERRUPTED, output
    assert "VERDICT: INCOMPLETE (interrupted before the first item)" in output
    assert list(reports.iterdir()) == []
    assert "Traceback" not in output
    assert all_end(running)


INTERRUPTING = """
import os, signal, time

def pytest_{stage}(session):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(60)
"""


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("stage", ["collection", pytest.param("sessionstart", marks=pytest.mark.long)])
def test_a_run_that_is_interrupted_before_its_items_are_known_leaves_no_report_of_an_earlier_one(
    repository: Repository, stage: str
) -> None:
    repository.write(conftest_py=INTERRUPTING.format(stage=stage))
    reports = repository.root / "reports" / "latest"
    reports.mkdir(parents=True)
    for name in ("run.json", "report.html", "verdict.json"):
        (reports / name).write_text("of an earlier run", encoding="utf-8")
    with started(repository, "--otmcp-reps=1") as process:
        output, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == pytest.ExitCode.INTERRUPTED, output
    assert "VERDICT: INCOMPLETE (interrupted before the items were collected)" in output
    assert list(reports.iterdir()) == []


HTTP = """
[subject]
name = "over HTTP"
version = "1.0"

[adapter.modbus]
command = {command}
transport = "http"
url = "http://127.0.0.1:{{http_port}}/mcp"
env = {{ MODBUS_HOST = "{{host}}", MODBUS_PORT = "{{port}}", MCP_TRANSPORT = "streamable-http", MCP_HTTP_PORT = "{{http_port}}" }}
rw = {{ env = {{ MODBUS_WRITES_ENABLED = "true" }} }}
deadline_s = 30
"""


def told(process: psutil.Process) -> dict[str, str]:
    """Return the environment of a process; of one that hides it from this user, such as a mock, nothing."""
    try:
        return process.environ()
    except psutil.AccessDenied:
        return {}


@pytest.mark.long
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("ending", ["SIGTERM", "SIGINT"])
def test_an_http_adapter_with_writes_enabled_does_not_outlive_a_run_that_is_ended(
    repository: Repository, waiting: socket.socket, ending: str
) -> None:
    command = [sys.executable, str(WAITING), "write_register", "2", port_of(waiting)]
    repository.write(otmcp_toml=HTTP.format(command=json.dumps(command)) + OUTSIDE)
    with started(repository, "--otmcp-reps=3", "-k", "normal and M3") as process:
        connection, _ = waiting.accept()
        with connection:
            running = descendants(process)
            assert [one for one in running if told(one).get("MODBUS_WRITES_ENABLED") == "true"]
            process.send_signal(signal.Signals[ending])
            output, _ = process.communicate(timeout=PATIENCE_S)
            assert all_end(running)
    assert process.returncode == pytest.ExitCode.INTERRUPTED, output
    assert "VERDICT: INCOMPLETE" in output


@pytest.mark.long
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("ending", ["SIGTERM", "SIGINT"])
def test_a_parallel_run_that_is_ended_records_what_was_running_and_leaves_nothing(
    repository: Repository, waiting: socket.socket, ending: str
) -> None:
    repository.subject("write_register", "3", port_of(waiting), program=WAITING)
    command = [*SUITE, "--otmcp-reps=3", "-k", "normal and (M1 or M2 or M3)", "-n", "2", "-p", "xdist.plugin"]
    with started(repository, *command) as process:
        connection, _ = waiting.accept()
        with connection:
            running = descendants(process)
            process.send_signal(signal.Signals[ending])
            output, _ = process.communicate(timeout=PATIENCE_S)
    outcome = repository.outcome(process.returncode, output)
    assert outcome.code == pytest.ExitCode.INTERRUPTED, output
    assert outcome.record["footer"]["reason"] == (
        "interrupted by the user" if ending == "SIGINT" else "ended by SIGTERM"
    )
    assert "VERDICT: INCOMPLETE" in output
    # The other worker may have had any of the others, or none.
    assert outcome.statuses["M3"] == "INTERRUPTED"
    assert [len(item["samples"]) for item in outcome.record["items"] if item["id"] == "M3"] == [1]
    assert set(outcome.statuses.values()) <= {"PASS", "INTERRUPTED"}
    assert "M3 INTERRUPTED" in output
    assert "Traceback" not in output
    assert all_end(running)


ENDED_BEFORE_IT_TOOK_A_RESULT = """
import os, signal

class Controller:
    def __init__(self):
        os.mkfifo("done")

    def pytest_runtest_logstart(self, nodeid):
        # The only worker opens the other end when it has sent all that it will send.
        open("done").close()
        os.kill(os.getpid(), signal.SIGTERM)

class Worker:
    def pytest_runtest_logfinish(self, nodeid):
        # The last one: a worker begins with the end of the suite.
        if "M1" in nodeid:
            open("done", "w").close()

def pytest_configure(config):
    config.pluginmanager.register(Worker() if hasattr(config, "workerinput") else Controller())
"""


@pytest.mark.long
@pytest.mark.usefixtures("interruptible")
def test_a_result_that_was_sent_before_a_parallel_run_is_ended_is_in_the_record(repository: Repository) -> None:
    repository.subject()
    repository.write(ending_py=ENDED_BEFORE_IT_TOOK_A_RESULT)
    options = ("--otmcp-reps=1", "-k", "normal and (M1 or M2)", "-n", "1")
    outcome = repository.pytest(*SUITE, *options, plugins="xdist.plugin ending", path=(repository.root,))
    assert outcome.code == pytest.ExitCode.INTERRUPTED, outcome.output
    assert outcome.statuses == {"M1": "PASS", "M2": "PASS"}
    assert outcome.record["footer"]["reason"] == "ended by SIGTERM"


@pytest.mark.long
def test_a_worker_begins_with_the_items_that_take_longest_and_the_record_has_the_order_of_the_suites(
    repository: Repository,
) -> None:
    repository.subject()
    selected = ("--otmcp-reps=1", "-k", "[M1] or [FM1] or [S1]", "-n", "1")
    outcome = repository.pytest(*SUITE, *selected, plugins="xdist.plugin")
    items = outcome.record["items"]
    assert [item["id"] for item in items] == ["M1", "FM1", "S1"]
    assert [item["id"] for item in sorted(items, key=itemgetter("began_ns"))] == ["S1", "FM1", "M1"]


@pytest.mark.long
@pytest.mark.parametrize("parallel", [(), ("-n", "2", "-p", "xdist.plugin")])
def test_a_killed_run_leaves_nothing_running(
    repository: Repository, waiting: socket.socket, parallel: tuple[str, ...]
) -> None:
    repository.subject("write_register", "3", port_of(waiting), program=WAITING)
    with started(repository, "--otmcp-reps=3", "-k", "normal and (M1 or M2 or M3)", *parallel) as process:
        connection, _ = waiting.accept()
        with connection:
            running = descendants(process)
            process.kill()
            assert all_end(running)


AT_A_MOMENT = """
import os, signal

def pytest_{moment}:
    os.kill(os.getpid(), signal.{ending})
"""


def _moments() -> Iterator[Any]:
    """Hooks during which a run is ended, and the signal that ends it."""
    for moment in (
        "sessionstart(session)",
        "collectstart(collector)",
        "collection_modifyitems(items)",
        "collection_finish(session)",
        "runtest_setup(item)",
        "runtest_logreport(report)",
        "runtest_logfinish(nodeid)",
        "sessionfinish(session)",
        "terminal_summary(config)",
    ):
        for ending in ("SIGTERM", "SIGINT"):
            one = (moment, ending) == ("runtest_logreport(report)", "SIGTERM")
            yield pytest.param(moment, ending, marks=() if one else pytest.mark.long)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize(("moment", "ending"), list(_moments()))
def test_a_run_ends_with_its_verdict_at_whatever_moment_it_is_ended(
    repository: Repository, moment: str, ending: str
) -> None:
    repository.subject()
    repository.write(ending_py=AT_A_MOMENT.format(moment=moment, ending=ending))
    options = ("--otmcp-reps=1", "-k", "normal and (M1 or M2)")
    outcome = repository.pytest(*SUITE, *options, plugins="ending", path=(repository.root,))
    assert "VERDICT: INCOMPLETE" in outcome.output, outcome.output
    assert "Traceback" not in outcome.output
    assert "INTERNALERROR" not in outcome.output


@pytest.mark.long
def test_a_mock_that_is_killed_accuses_nobody(repository: Repository, waiting: socket.socket) -> None:
    repository.subject("read_input_registers", "2", port_of(waiting), program=WAITING)
    with started(repository, "--otmcp-reps=3", "-k", "normal and (M1 or M2)") as process:
        connection, _ = waiting.accept()
        with connection:
            mocks = [child for child in descendants(process) if "pytest_otmcp.mocks" in " ".join(child.cmdline())]
            assert mocks
            for mock in mocks:
                # A device ends by itself after its launcher, so it may be gone already.
                with contextlib.suppress(psutil.NoSuchProcess):
                    mock.kill()
            assert all_end(mocks)
        output, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 3, output
    assert "VERDICT: INDETERMINATE" in output
    assert "mock was killed by another program, as an adapter can do" in " ".join(output.split())


def on_terminal(repository: Repository, columns: int, *options: str) -> str:
    """Run the suite without colours on a terminal of this width, and return everything that it was sent."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    # COLUMNS in the environment would take precedence over the width of the terminal.
    environment = {name: value for name, value in repository.environment().items() if name not in ("COLUMNS", "CI")}
    environment |= {"TERM": "xterm", "NO_COLOR": "1"}
    command = repository.command(*SUITE, *options)
    with subprocess.Popen(command, cwd=repository.root, stdout=theirs, stderr=theirs, env=environment):
        os.close(theirs)
        told = b""
        # Linux answers EIO when no process holds the other end any more.
        with contextlib.suppress(OSError):
            while chunk := os.read(ours, 65536):
                told += chunk
    os.close(ours)
    return told.decode()


def screen(told: str) -> list[str]:
    """Return the lines as a terminal shows them that is wide enough: after a carriage return the line is written over."""
    lines = []
    for line in told.replace("\r\n", "\n").split("\n"):
        shown = ""
        for part in line.split("\r"):
            shown = part + shown[len(part) :]
        lines.append(shown.rstrip())
    return lines


@pytest.mark.long
def test_a_narrow_terminal_without_colours_shows_progress_and_no_line_breaks_at_its_edge(
    repository: Repository,
) -> None:
    columns = 60
    repository.subject("write-sent-twice")
    told = on_terminal(repository, columns, "--otmcp-reps=2", "-k", "[M1] or [M4] or [Q1] or [Q2] or [FQ1] or [FM1]")
    assert "\x1b" not in told
    assert "\r  starting 2 devices and 2 adapters (0 of 4)" in told
    assert "(4 of 4)" in told
    assert re.search(r"\r  M1 +0/2   item 1 of \d+, about", told), told
    parts = [part for line in told.split("\n") for part in line.rstrip("\r").split("\r")]
    # What pytest writes before and behind has a width of its own.
    shown = screen(told[told.index("collected") : told.rindex("\n=")])
    assert max(map(len, shown)) <= columns
    assert max(len(part) for part in parts if part.startswith(("  M1", "  FM1", "  starting"))) <= columns
    items = shown[: next(index for index, line in enumerate(shown) if line.startswith("suite "))]
    rows = [line for line in items if re.match(r"  (?:\S+ +\d/\d|starting|n/a)", line)]
    assert [row.split()[0] for row in rows] == ["M1", "M4", "FM1"]
    assert re.match(r"  M4 +2/2 FAIL +[\d.]+ ms  failed beside", rows[1])
    assert rows[-1].endswith("%]")
    assert not [line for line in shown if re.match(r"\s*\[? *\d+%\]", line)]
    verdict = next(
        index for index, line in enumerate(shown) if line.startswith("VERDICT: NOT CONFORMANT (2 of 11 Modbus items")
    )
    assert shown[verdict + 1].startswith("  ")
    assert "FAILURES" not in told
    assert "short test summary" not in told
    assert "M4 rep" not in told


# -- options ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        ("--otmcp-reps=many", "--otmcp-reps: expected a whole number, found 'many'"),
        ("--otmcp-reps=0", "--otmcp-reps: expected 1 to 100000, found 0"),
        ("--otmcp-suite=falt", "--otmcp-suite: 'falt' is unknown; did you mean 'fault'?"),
        ("--otmcp-era=stone", "--otmcp-era: 'stone' is unknown"),
        ("--otmcp-time-scale=fast", "--otmcp-time-scale: expected a number, found 'fast'"),
        ("--otmcp-broker=http://x", "--otmcp-broker: expected mqtt://host:port, found 'http://x'"),
        (
            "--otmcp-device=mqtt=mqtt://x",
            "real devices are taken for modbus, opcua, s7, bacnet, dnp3, not for 'mqtt'; use --otmcp-broker",
        ),
        (
            "--otmcp-device=profinet=tcp://x",
            "--otmcp-device: real devices are taken for modbus, opcua, s7, bacnet, dnp3, not for 'profinet'",
        ),
        ("--otmcp-device=dnp3=tcp://x/10/1/1", "--otmcp-device: expected tcp://host:port, found 'tcp://x/10/1/1'"),
        ("--otmcp-device=dnp3=tcp://x/65520", "--otmcp-device: expected tcp://host:port, found 'tcp://x/65520'"),
        ("--otmcp-device=opcua=opc.tcp://x/UA/Server", "--otmcp-device: expected opc.tcp://host:port, found"),
        ("--otmcp-device=opcua=opc.tcp://x/ns=2;s=a?b", "--otmcp-device: expected opc.tcp://host:port, found"),
        ("--otmcp-device=bacnet=udp://x/12345/1/2", "--otmcp-device: expected udp://host:port, found"),
        ("--otmcp-device=modbus=http://x", "--otmcp-device: expected tcp://host:port, found 'http://x'"),
        ("--otmcp-device=modbus=tcp://x/70000", "--otmcp-device: expected tcp://host:port, found 'tcp://x/70000'"),
        ("--otmcp-device=modbus=tcp://x:0", "--otmcp-device: expected tcp://host:port, found 'tcp://x:0'"),
        ("--otmcp-device=opcua=opc.tcp://x/i=4294967296", "--otmcp-device: expected opc.tcp://host:port, found"),
        ("--otmcp-device=opcua=opc.tcp://x/ns=65536;s=a", "--otmcp-device: expected opc.tcp://host:port, found"),
        ("--otmcp-device=modbus=tcp://me:secret@x", "--otmcp-device: expected tcp://host:port"),
        ("--otmcp-consent=nowhere.toml", "--otmcp-consent: "),
        ("--otmcp-mirror=nowhere.pcap", "nowhere.pcap: there is no such file"),
        (f"--otmcp-mirror={__file__}", "--otmcp-mirror: it is for one real device, and --otmcp-device names none"),
        ("--otmcp-subject=nowhere.toml", "nowhere.toml: there is no such file"),
    ],
)
def test_a_bad_option_is_refused_in_one_sentence(pytester: pytest.Pytester, option: str, sentence: str) -> None:
    with pytest.raises(UsageError) as refusal:
        read_settings(pytester.parseconfig(option))
    assert sentence in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_the_address_of_a_real_device_keeps_its_brackets(pytester: pytest.Pytester) -> None:
    named = ("--otmcp-device=modbus=tcp://[::1]", "--otmcp-device=opcua=opc.tcp://[FE80::1]:4841/ns=65535;i=4294967295")
    found = read_settings(pytester.parseconfig(*named)).external
    assert found == {"modbus": "tcp://[::1]:502", "opcua": "opc.tcp://[fe80::1]:4841/ns=65535;i=4294967295"}


@pytest.mark.parametrize(
    ("options", "soak"), [((), False), (("--otmcp-soak",), True), (("-o", "otmcp_soak=true"), True)]
)
def test_long_forms_are_asked_for_by_option_or_ini(
    pytester: pytest.Pytester, options: tuple[str, ...], soak: bool
) -> None:
    assert read_settings(pytester.parseconfig(*options)).soak is soak


def test_a_run_with_a_bad_option_ends_with_that_sentence_and_code_2(repository: Repository) -> None:
    outcome = repository.pytest(*SUITE, "--otmcp-suite=falt")
    assert outcome.code == 2
    assert "--otmcp-suite: 'falt' is unknown; did you mean 'fault'?" in outcome.output
    assert "Traceback" not in outcome.output


@pytest.mark.parametrize("parallel", [(), ("-n", "2")])
def test_a_mistake_in_the_subject_file_is_said_once_in_its_sentence(
    repository: Repository, parallel: tuple[str, ...]
) -> None:
    repository.write(otmcp_toml=HTTP.format(command='["x"]').replace("{port}", "{prot}"))
    outcome = repository.pytest("--otmcp-reps=1", *parallel, plugins="xdist")
    assert outcome.code == 2
    assert "adapter.modbus.env.MODBUS_PORT: {prot} is not replaced; did you mean {port}?" in outcome.output
    assert "ERROR" not in outcome.output
    assert "During handling" not in outcome.output


def test_the_plugin_is_inert_where_nothing_of_it_is_collected(repository: Repository) -> None:
    repository.write(
        test_own_py="import sys\n"
        "def test_own():\n"
        "    heavy = {'mcp', 'pymodbus', 'asyncua', 'paho', 'scipy', 'numpy', 'matplotlib', 'jmespath', 'jsonschema'}\n"
        "    heavy |= {'anyio', 'pydantic', 'google', 'jinja2', 'pytest_otmcp.trial.bench', 'pytest_otmcp.subject'}\n"
        "    assert not heavy & set(sys.modules)\n"
    )
    # The figures' module stays as it is, so that the plugin runs alone.
    outcome = repository.pytest("test_own.py", drawn=True)
    assert outcome.code == 0, outcome.output
    assert "VERDICT" not in outcome.output
    assert not (repository.root / "reports").exists()
