"""A misbehaving process ends in a clear finding within a deadline, and leaves nothing behind."""

from __future__ import annotations

import re
import sys
from typing import Any

import psutil
import pytest

from .conftest import HERE, IMPATIENT, Judge, failing, words


def rogue(mode: str) -> tuple[str, ...]:
    """Return the command of a rogue process, which is started as a vendor's adapter is."""
    return (sys.executable, str(HERE / "rogue.py"), mode)


@pytest.fixture(autouse=True)
def nothing_is_left_behind() -> Any:
    before = {process.pid for process in psutil.Process().children(recursive=True)}
    yield
    left = [
        process
        for process in psutil.Process().children(recursive=True)
        if process.pid not in before and "rogue.py" in " ".join(process.cmdline())
    ]
    assert left == []


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        ("dead", r"exited with code 1.*spindle\.conf: no such file"),
        pytest.param(
            "dies-in-initialize",
            r"exited with code 3 during its handshake.*no module named 'spindle'",
            marks=pytest.mark.long,
        ),
        pytest.param(
            "stdout-flood",
            r"floods stdout with lines that are no MCP messages.*I am the spindle",
            marks=pytest.mark.long,
        ),
        pytest.param("wrong-id", r"a response carries the id \d{4}, which no request had", marks=pytest.mark.long),
        pytest.param("huge-reply", r"a message of more than 4 MiB", marks=pytest.mark.long),
        ("dies-in-call", r"exited with code 7.*out of spindle oil"),
        pytest.param("hangs-in-call", r"no reply within the deadline of 2 s", marks=pytest.mark.long),
        ("not-json", r"not strict JSON: NaN is no JSON number"),
        pytest.param("stderr-flood", r"the device should have answered at least", marks=pytest.mark.long),
    ],
)
def test_the_finding_says_what_the_process_did(judge: Judge, mode: str, expected: str) -> None:
    results = judge("modbus", command=rogue(mode), tasks="M1", time_scale=IMPATIENT)
    assert failing(results) == {"M1"}
    assert results["M1"]["status"] == "FAIL"
    assert re.search(expected, words(results), re.DOTALL), words(results)


@pytest.mark.long
def test_an_adapter_that_hangs_in_its_handshake_is_waited_for_once(judge: Judge) -> None:
    results = judge("modbus", command=rogue("hangs-in-initialize"), tasks="M1 M2 M3 FM1", time_scale=0.15)
    assert failing(results) == {"M1", "M2", "M3", "FM1"}
    assert "did not finish its handshake within" in words(results)


@pytest.mark.long
def test_an_adapter_that_stops_at_todays_handshake_gets_the_older_one(judge: Judge) -> None:
    results = judge("modbus", command=rogue("stops-at-discover"), tasks="M1", time_scale=0.15)
    assert "M1: the device should have answered at least 1 request(s) during the call(s), it saw none" in words(results)
    assert "handshake" not in words(results)


def test_what_is_said_of_a_failed_start_does_not_name_the_home_directory(
    judge: Judge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(HERE))
    said = words(judge("modbus", command=rogue("dies-in-initialize"), tasks="M1", time_scale=IMPATIENT))
    assert "~/rogue.py dies-in-initialize" in said
    assert str(HERE) not in said


def test_what_is_said_of_a_failed_start_calls_the_working_folder_by_its_placeholder(judge: Judge) -> None:
    command = (*rogue("dies-in-initialize"), "{work}/config.json")
    assert "dies-in-initialize {work}/config.json)" in words(judge("modbus", command=command, tasks="M1"))


def test_a_missing_command_is_named(judge: Judge) -> None:
    results = judge("modbus", command=("adapter-of-nobody", "--stdio"), tasks="M1")
    assert "the command 'adapter-of-nobody' was not found" in words(results)


@pytest.mark.long
def test_a_process_that_never_exits_is_killed_and_reported(judge: Judge) -> None:
    results = judge("modbus", command=rogue("never-exits"), tasks="R-modbus", time_scale=IMPATIENT)
    assert "did not exit within" in words(results)


def test_children_of_the_adapter_are_ended_too(judge: Judge) -> None:
    before = set(psutil.pids())
    judge("modbus", command=rogue("forks"), tasks="M1")
    left = [
        process
        for process in psutil.process_iter(["pid", "cmdline", "status"])
        if process.pid not in before
        and process.info["status"] != psutil.STATUS_ZOMBIE
        and "time.sleep(3600)" in " ".join(process.info["cmdline"] or [])
    ]
    # A killed process ends when the system lets it run once more, which may take a while.
    assert psutil.wait_procs(left, timeout=60)[1] == []
