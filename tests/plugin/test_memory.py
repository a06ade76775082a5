"""What an adapter sends does not fill the memory of the process that judges it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from .vendor import Repository

HOSTILE = Path(__file__).parents[1] / "soundness" / "hostile.py"
SUITE = ("--pyargs", "pytest_otmcp.conformance", "--otmcp-reps=1", "-k", "normal and M1")

LIMIT_MIB = 400

SUBJECT = """
[subject]
name = "hostile"
version = "1"

[adapter.modbus]
command = {command}
deadline_s = 3
start_timeout_s = 8
unclaimed = {{ read_input = "no", read_holding = "no", write_holding = "no", guard = "no", recovery = "no" }}
"""

PEAK = """
import pathlib, re

def pytest_unconfigure():
    # The peak of this process alone, since it was executed (proc_pid_status(5)).
    status = pathlib.Path("/proc/self/status").read_text()
    pathlib.Path("peak.txt").write_text(re.search(r"VmHWM:\\s+(\\d+) kB", status)[1])
"""

TOO_LARGE = "the adapter sent a message of more than 4 MiB or 200000 values"
TOO_DEEP = "nested more deeply than the MCP client reads"
LATE = "no reply within the deadline of 3 s"
SILENT = "the device should have answered at least 1 request(s)"


def peak_mib(repository: Repository) -> int:
    return int((repository.root / "peak.txt").read_text()) // 1024


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("megabyte", SILENT),
        pytest.param("most-bytes", SILENT, marks=pytest.mark.weekly),
        ("most-values", SILENT),
        pytest.param("most-members", SILENT, marks=pytest.mark.weekly),
        ("large-reply", TOO_LARGE),
        pytest.param("large-text", TOO_LARGE, marks=pytest.mark.weekly),
        ("deep", TOO_DEEP),
        pytest.param("very-deep", TOO_DEEP, marks=pytest.mark.weekly),
        pytest.param("deep-in-call", TOO_DEEP, marks=pytest.mark.weekly),
        pytest.param("notifications-in-call", LATE, marks=pytest.mark.weekly),
        pytest.param("progress-in-call", LATE, marks=pytest.mark.weekly),
        pytest.param("requests-in-call", LATE, marks=pytest.mark.weekly),
        pytest.param("responses-in-call", "which no request had", marks=pytest.mark.weekly),
        ("noise-in-call", "on stdout that are no MCP message"),
        ("stdout-without-newline", TOO_LARGE),
        ("stderr-without-newline", SILENT),
        ("long-description", TOO_LARGE),
    ],
)
def test_what_an_adapter_sends_does_not_fill_the_memory(empty_repository: Repository, kind: str, said: str) -> None:
    command = json.dumps([sys.executable, str(HOSTILE), kind, "token"])
    empty_repository.write(peak_py=PEAK, otmcp_toml=SUBJECT.format(command=command))
    outcome = empty_repository.pytest(*SUITE, plugins="peak", path=(empty_repository.root,))
    assert outcome.statuses == {"M1": "FAIL"}, outcome.output
    assert said in " ".join(outcome.output.split())
    assert (said == TOO_LARGE) == (TOO_LARGE in " ".join(outcome.output.split()))
    assert peak_mib(empty_repository) < LIMIT_MIB


FIFTY_CALLS = ("--pyargs", "pytest_otmcp.conformance", "--otmcp-reps=1", "-k", "[S7]")

BOUND = """
[adapter.modbus.bind]
read_input = { tool = "ping", result = { values = "data.values" } }
"""


@pytest.mark.long
@pytest.mark.parametrize(
    "kind", ["most-values", *(pytest.param(kind, marks=pytest.mark.weekly) for kind in ("most-bytes", "most-members"))]
)
def test_fifty_of_the_largest_answers_do_not_fill_the_memory(empty_repository: Repository, kind: str) -> None:
    command = json.dumps([sys.executable, str(HOSTILE), kind, "token"])
    subject = SUBJECT.format(command=command).replace('read_input = "no", ', "") + BOUND
    empty_repository.write(peak_py=PEAK, otmcp_toml=subject)
    outcome = empty_repository.pytest(*FIFTY_CALLS, plugins="peak", path=(empty_repository.root,))
    assert outcome.statuses == {"S7": "FAIL"}, outcome.output
    assert TOO_LARGE in " ".join(outcome.output.split())
    assert peak_mib(empty_repository) < LIMIT_MIB
