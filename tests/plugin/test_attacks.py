"""What an adapter without walls does to the machine on which it is judged, and what the machine does to the kit."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from .test_memory import HOSTILE, SUBJECT
from .vendor import Outcome, Repository

LONG = pytest.mark.long
SUITE = ("--pyargs", "pytest_otmcp.conformance", "--otmcp-reps=2", "-k", "normal and M1")

_CAPBSET_DROP = 24
_LOOKING = (19, 21, 38)
"""CAP_SYS_PTRACE, CAP_SYS_ADMIN and CAP_PERFMON."""


def without_tracing() -> None:
    """Give up the rights of root to look into every process (capabilities(7)); another user does not have it."""
    for capability in _LOOKING:
        ctypes.CDLL(None).prctl(_CAPBSET_DROP, capability, 0, 0, 0)


def attacked(repository: Repository, kind: str, *options: str, tmpdir: str | None = None) -> Outcome:
    """Run a suite with a hostile adapter as a user who may not trace other people's processes."""
    command = json.dumps([sys.executable, str(HOSTILE), kind, "token"])
    repository.write(otmcp_toml=SUBJECT.format(command=command))
    environment = repository.environment()
    if tmpdir is not None:
        environment["TMPDIR"] = tmpdir
    done = subprocess.run(
        repository.command(*(options or SUITE), "--otmcp-isolation=off"),
        cwd=repository.root,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        preexec_fn=without_tracing,
    )
    outcome = repository.outcome(done.returncode, done.stdout + done.stderr)
    assert "INTERNALERROR" not in outcome.output
    return outcome


@pytest.mark.long
def test_kit_keeper_and_devices_keep_their_memory_and_environment_to_themselves(empty_repository: Repository) -> None:
    attacked(empty_repository, "looks-around")
    seen = json.loads((empty_repository.root / "seen.json").read_text(encoding="utf-8"))
    assert ["child", True, True] in seen
    others = [entry for entry in seen if entry[0] != "child"]
    lines = "\n".join(line for line, *_ in others)
    # The kit, the keeper and the watcher, the launcher and the device.
    assert "-m pytest " in lines
    assert lines.count("session.keeper import main") == 2
    assert lines.count("pytest_otmcp.mocks modbus") == 2
    assert [entry for entry in others if entry[1] or entry[2]] == []


@LONG
def test_a_device_that_an_adapter_kills_gives_no_verdict(empty_repository: Repository) -> None:
    outcome = attacked(empty_repository, "kills-the-device")
    assert outcome.code == 3, outcome.output
    assert outcome.statuses == {"M1": "KIT_ERROR"}
    words = " ".join(outcome.output.split())
    assert "the modbus mock was killed by another program, as an adapter can do" in words
    assert "file a bug" not in words
    assert "Traceback" not in outcome.output


@LONG
def test_a_report_directory_that_an_adapter_moves_is_no_bug(empty_repository: Repository) -> None:
    outcome = attacked(empty_repository, "moves-the-report-directory")
    assert outcome.code == 3, outcome.output
    words = " ".join(outcome.output.split())
    assert "as an adapter can do" in words or "an adapter can do that to the files of a report directory" in words
    assert "file a bug" not in words
    assert "Traceback" not in outcome.output
    assert "VERDICT: CONFORMANT (" not in outcome.output


def test_samples_that_an_adapter_rewrites_during_its_item_end_the_run(empty_repository: Repository) -> None:
    outcome = attacked(empty_repository, "rewrites-the-record")
    assert outcome.code == 3, outcome.output
    words = " ".join(outcome.output.split())
    assert "run.json cannot be written: another program has changed the samples of an item" in words
    assert "Traceback" not in outcome.output
    assert "VERDICT: CONFORMANT (" not in outcome.output


@LONG
def test_a_pipe_in_place_of_the_record_ends_the_run(empty_repository: Repository) -> None:
    outcome = attacked(
        empty_repository,
        "puts-a-pipe-in-place-of-the-record",
        *SUITE[:2],
        "--otmcp-suite=normal,requirements",
        "-k",
        "[M1] or MCP-010.modbus",
    )
    assert outcome.code == 3, outcome.output
    words = " ".join(outcome.output.split())
    assert "run.json cannot be written: it is a pipe, a socket, a device or a folder, where a regular file" in words
    assert "Traceback" not in outcome.output
    assert "VERDICT: CONFORMANT (" not in outcome.output


def test_files_that_an_adapter_plants_are_told(empty_repository: Repository) -> None:
    outcome = attacked(empty_repository, "plants-files")
    assert outcome.code == 1, outcome.output
    what = {"conftest.py": "made", "otmcp.toml": "changed", "matplotlibrc": "made"}
    assert {
        f"{name} was {how} during the run; look at it before anything else is run here" for name, how in what.items()
    } <= {*outcome.narrowed}


@contextmanager
def small_disk(kib: int) -> Iterator[Path]:
    """Mount a disk of this size, which root may."""
    with tempfile.TemporaryDirectory(prefix="otmcp-t", dir="/tmp") as directory:
        mounted = subprocess.run(
            ["/usr/bin/mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", directory],
            capture_output=True,
            text=True,
            check=False,
        )
        if mounted.returncode:
            pytest.skip(f"no disk can be mounted here: {mounted.stderr.strip()}")
        try:
            yield Path(directory)
        finally:
            subprocess.run(["/usr/bin/umount", "-l", directory], check=True)


@LONG
@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a disk")
def test_a_full_disk_ends_the_run_in_one_sentence_and_keeps_what_was_measured(empty_repository: Repository) -> None:
    empty_repository.subject()
    suite = ("--pyargs", "pytest_otmcp.conformance", "--otmcp-reps=30", "-k", "normal and (M1 or M2 or M3 or M4 or M5)")
    with small_disk(160) as disk:
        outcome = empty_repository.pytest(*suite, f"--otmcp-report-dir={disk}/r")
        kept = Outcome(code=outcome.code, output=outcome.output, report=disk / "r").statuses
    words = " ".join(outcome.output.split())
    assert outcome.code == 3, outcome.output
    assert "no space left" in words or "disk is full" in words, outcome.output
    assert "Traceback" not in outcome.output
    assert "INTERNALERROR" not in outcome.output
    assert "file a bug" not in outcome.output
    assert kept["M1"] == "PASS"
    assert set(kept.values()) <= {"PASS", "KIT_ERROR"}


@LONG
@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a disk")
def test_an_adapter_that_fills_the_temporary_directory_gets_its_finding(empty_repository: Repository) -> None:
    with small_disk(512) as disk:
        outcome = attacked(empty_repository, "fills-the-temporary-directory", tmpdir=str(disk))
    assert "Traceback" not in outcome.output
    assert outcome.code in (1, 3), outcome.output
    assert "VERDICT: CONFORMANT (" not in outcome.output


@pytest.mark.long
def test_live_logs_show_the_words_of_an_adapter_marked(empty_repository: Repository) -> None:
    outcome = attacked(
        empty_repository, "forges-lines", *SUITE, "-o", "log_cli=true", "-o", "log_cli_level=DEBUG", "-rA"
    )
    assert "live log" in outcome.output
    assert [line for line in outcome.output.splitlines() if line.startswith("VERDICT: CONFORMANT")] == []
    assert [line for line in outcome.output.splitlines() if line.startswith("::")] == []
    assert "\x1b[2J" not in outcome.output
