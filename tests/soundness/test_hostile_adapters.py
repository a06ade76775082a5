"""What an adapter does to the kit ends within its deadline, in a clear finding, and leaves nothing behind."""

from __future__ import annotations

import re
import secrets
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from pytest_otmcp.soundness.defect import ADAPTERS
from pytest_otmcp.subject import Adapter

from .conftest import HERE, IMPATIENT, Judge, failing, words

LONG = pytest.mark.long


@pytest.fixture
def token() -> Iterator[str]:
    """A word in the command line of whatever a hostile adapter starts; nothing that has it outlives the test."""
    word = secrets.token_hex(8)
    yield word
    left = [process for process in psutil.process_iter(["cmdline"]) if word in (process.info["cmdline"] or ())]
    assert left == []


def hostile(kind: str, token: str) -> tuple[str, ...]:
    """Return the command of a hostile adapter, which is started as a vendor's adapter is."""
    return (sys.executable, str(HERE / "hostile.py"), kind, token)


LEFT = r"the adapter ended and left processes running, which had to be killed: python"
TOO_LARGE = r"the adapter sent a message of more than 4 MiB or 200000 values"
NOTHING_WRONG = r"the device should have answered at least 1 request\(s\) during the call\(s\), it saw none"
"""All that there is to say of it: it never asks the device."""


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        pytest.param("slow-pattern", r"the outputSchema of tool ping cannot be checked within 5 s", marks=LONG),
        pytest.param("slow-pattern-of-names", r"is not of type 'null'", marks=LONG),
        pytest.param("slow-references", r"the outputSchema of tool ping cannot be checked within 5 s", marks=LONG),
        pytest.param("endless-reference", r"nested too deeply", marks=LONG),
        pytest.param("foreign-reference", r"Unresolvable: http://127\.0\.0\.1:9/schema\.json", marks=LONG),
        pytest.param("contradicts-itself", r"a request was answered more than once, the first: id \d"),
        pytest.param("contradicts-itself-later", r"a request was answered more than once", marks=LONG),
        pytest.param("says-it-twice", r"a request was answered more than once", marks=LONG),
        pytest.param("deep", r"1 message\(s\) nested more deeply than the MCP client reads", marks=LONG),
        pytest.param("very-deep", r"1 message\(s\) nested more deeply than the MCP client reads", marks=LONG),
        pytest.param("noise-in-call", r"on stdout that are no MCP message.*I am the spindle", marks=LONG),
        pytest.param("stdout-noise", r"floods stdout with lines that are no MCP messages", marks=LONG),
        pytest.param("stdout-without-newline", TOO_LARGE, marks=LONG),
        pytest.param("stderr-without-newline", NOTHING_WRONG, marks=LONG),
        pytest.param("notifications-in-call", r"no reply within the deadline", marks=LONG),
        pytest.param("progress-in-call", r"no reply within the deadline", marks=[LONG, pytest.mark.weekly]),
        pytest.param("trickles", r"no reply within the deadline", marks=LONG),
        pytest.param("large-reply", TOO_LARGE, marks=LONG),
        pytest.param("large-text", TOO_LARGE, marks=LONG),
        pytest.param("not-utf-8", r"no reply within the deadline", marks=LONG),
        pytest.param("lone-surrogate", r"1 line\(s\) on stdout that are no MCP message", marks=LONG),
        pytest.param("long-number", r"no reply within the deadline|not strict JSON", marks=LONG),
        pytest.param("null-id", r"no reply within the deadline", marks=LONG),
        pytest.param("text-id", r"a response carries the id '\d", marks=LONG),
        pytest.param("duplicate-keys", r"not strict JSON", marks=LONG),
        pytest.param("crlf", NOTHING_WRONG, marks=LONG),
        pytest.param("asks-back", NOTHING_WRONG, marks=LONG),
        pytest.param("crashes-in-initialize", r"was killed by signal 11 during its handshake", marks=LONG),
        pytest.param("bad-protocol-version", r"handshake failed: .*1492-10-12", marks=LONG),
        pytest.param("closes-stdout", r"handshake", marks=LONG),
        pytest.param("ignores-sigterm-in-initialize", r"did not finish its handshake within", marks=LONG),
        pytest.param("pages-for-ever", r"did not finish its handshake within", marks=[LONG, pytest.mark.weekly]),
        pytest.param("pages-in-a-circle", r"did not finish its handshake within", marks=[LONG, pytest.mark.weekly]),
        pytest.param("many-tools", TOO_LARGE, marks=LONG),
        pytest.param("nameless-tool", r"handshake failed", marks=LONG),
        pytest.param("long-description", TOO_LARGE, marks=LONG),
        pytest.param("bad-pattern", r"is not a 'regex'", marks=LONG),
        pytest.param("many-duplicate-keys", r"the member '89999' occurs twice", marks=LONG),
        pytest.param("very-long-names", NOTHING_WRONG, marks=LONG),
        pytest.param("closes-stdout-in-call", r"no reply", marks=LONG),
        pytest.param("puts-a-pipe-in-place-of-stdout", NOTHING_WRONG, marks=LONG),
        pytest.param("floods-stderr-in-call", NOTHING_WRONG, marks=LONG),
        pytest.param("never-reads-again", NOTHING_WRONG, marks=LONG),
        pytest.param("says-the-list-has-changed", NOTHING_WRONG, marks=LONG),
        pytest.param("cancels-the-request", NOTHING_WRONG, marks=LONG),
        pytest.param("asks-by-the-same-id", NOTHING_WRONG, marks=LONG),
        pytest.param("answers-what-comes-next", r"a response carries the id \d+, which no request had", marks=LONG),
        pytest.param("in-a-batch", r"1 line\(s\) on stdout that are no MCP message", marks=LONG),
        pytest.param("after-blanks", NOTHING_WRONG, marks=LONG),
        pytest.param("structured-list", r"structuredContent", marks=LONG),
        pytest.param("error-in-words", r"isError is no although success is True", marks=LONG),
        pytest.param("odd-content", r"has no text block", marks=LONG),
        pytest.param("wants-more-input", r"has no structuredContent object", marks=LONG),
        pytest.param("becomes-a-task", r"has no structuredContent object", marks=LONG),
        pytest.param("error-of-words", r"answered with a JSON-RPC error", marks=LONG),
        pytest.param("result-and-error", r"answered with a result and with a JSON-RPC error at once", marks=LONG),
        pytest.param("error-code-of-any-size", r"answered with a JSON-RPC error", marks=LONG),
        pytest.param("meta-of-any-size", r"meta\.latency_ms says 1e\+308 ms", marks=LONG),
        pytest.param("meta-beyond-any-size", r"meta\.latency_ms says 9999", marks=LONG),
        pytest.param("year-zero", r"should be an RFC 3339 time", marks=LONG),
        pytest.param("dynamic-reference", r"Unresolvable: b\.json", marks=LONG),
        pytest.param("a-tool-of-escapes", r"answered with a JSON-RPC error", marks=LONG),
    ],
)
def test_the_finding_says_what_the_adapter_did(judge: Judge, token: str, kind: str, expected: str) -> None:
    # What is too large has to be made first, which on a busy machine takes longer than an impatient deadline.
    time_scale = 1.0 if expected == TOO_LARGE else IMPATIENT
    results = judge("modbus", command=hostile(kind, token), tasks="M1", time_scale=time_scale)
    assert failing(results) == {"M1"}
    assert results["M1"]["status"] == "FAIL"
    assert re.search(expected, words(results), re.DOTALL | re.IGNORECASE), words(results)


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param("many-children", marks=LONG),
        pytest.param("daemon", marks=LONG),
        pytest.param("daemon-with-pipes", marks=LONG),
        "daemon-of-a-daemon",
        pytest.param("daemon-ignores-signals", marks=LONG),
        pytest.param("rabbits", marks=LONG),
        pytest.param("forks-when-it-ends", marks=LONG),
        pytest.param("never-ends", marks=LONG),
        pytest.param("kills-its-parent", marks=LONG),
        pytest.param("stops-its-parent", marks=LONG),
        pytest.param("stops-the-keeper", marks=LONG),
        pytest.param("kills-the-keeper", marks=LONG),
        pytest.param("leaves-a-writer", marks=LONG),
    ],
)
def test_nothing_that_an_adapter_starts_outlives_its_session(judge: Judge, token: str, kind: str) -> None:
    results = judge("modbus", command=hostile(kind, token), tasks="M1", time_scale=0.2)
    assert results["M1"]["status"] == "FAIL"


@LONG
@pytest.mark.parametrize("kind", ["daemon", "daemon-of-a-daemon", "forks-when-it-ends", "many-children", "rabbits"])
def test_what_an_adapter_leaves_running_is_told(judge: Judge, token: str, kind: str) -> None:
    results = judge("modbus", command=hostile(kind, token), tasks="R-modbus")
    assert re.search(LEFT, words(results)), words(results)


@LONG
def test_who_comes_after_an_adapter_that_harms_the_keeper_is_not_accused(
    judge: Judge, token: str, walled: bool
) -> None:
    genuine = (sys.executable, "-P", "-m", ADAPTERS, "modbus")
    judge("modbus", command=hostile("stops-the-keeper", token), tasks="M1")
    assert judge("modbus", command=genuine, tasks="M1")["M1"]["status"] == "PASS"
    judge("modbus", command=hostile("limits-its-parents", token), tasks="M1")
    # The kit has a new keeper then. Behind walls nothing has harmed the first one.
    after = [judge("modbus", command=genuine, tasks="M1")["M1"]["status"] for _ in range(2)]
    assert after == ["PASS" if walled else "KIT_ERROR", "PASS"]


@LONG
def test_a_schema_of_any_size_is_looked_at_in_time(judge: Judge, token: str) -> None:
    results = judge("modbus", command=hostile("names-that-cannot-be-sorted", token), tasks="MCP-003.modbus")
    assert results["MCP-003.modbus"]["status"] == "FAIL"
    assert "a list of 90001 names has one that is no text" in words(results)


@LONG
def test_not_all_of_many_tools_are_called(judge: Judge, token: str) -> None:
    results = judge("modbus", command=hostile("two-hundred-tools", token), tasks="MCP-008.modbus")
    called = [call["tool"] for sample in results["MCP-008.modbus"]["samples"] for call in sample["calls"]]
    # A hundred, among them some that the reference adapter has. There is no second era of MCP: by then the adapter has said the same
    # wrong thing again and again.
    assert 75 < sum(tool.startswith("t") for tool in called) <= 100


@LONG
@pytest.mark.parametrize("kind", ["link", "second-name", "pipe"])
def test_what_an_adapter_puts_in_place_of_its_log_is_neither_read_nor_changed(
    judge: Judge, tmp_path: Path, kind: str, walled: bool
) -> None:
    def described(adapter: Adapter) -> Adapter:
        launch = adapter.variants["governed"]
        launch = replace(launch, env={**launch.env, "VICTIM_FOLDER": str(tmp_path)})
        openings = replace(adapter.openings, writes=(*adapter.openings.writes, tmp_path))
        return replace(adapter, variants={**adapter.variants, "governed": launch}, openings=openings)

    checks = "AUD-001.modbus AUD-002.modbus AUD-003.modbus"
    results = judge("modbus", "log_elsewhere.py", kind, described=described, tasks=checks)
    assert {result["status"] for result in results.values()} == {"FAIL"}, words(results)
    # No second name leads from what is open to an adapter to another folder that is.
    stopped = walled and kind == "second-name"
    assert ("Invalid cross-device link" if stopped else "the audit log has no record of it") in words(results)
    assert (tmp_path / "victim.txt").read_bytes() == b"not to be changed\n"
