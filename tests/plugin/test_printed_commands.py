"""Every command that a report prints works."""

from __future__ import annotations

import html
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from .command import OTMCP
from .vendor import Outcome, Repository

PROGRAMS = {"otmcp": OTMCP, "pytest": [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]}
COMMAND = re.compile(r"<code>((?:otmcp|pytest) [^<]*)</code>")


def printed(outcome: Outcome) -> list[str]:
    """Return the commands in the page, in the Markdown and on the terminal, each once."""
    page = (outcome.report / "report.html").read_text(encoding="utf-8")
    summary = (outcome.report / "summary.md").read_text(encoding="utf-8")
    found = [html.unescape(text) for text in COMMAND.findall(page)]
    found += [text.strip() for text in re.findall(r"`+ ?((?:otmcp|pytest) [^`]*)`+", summary)]
    found += re.findall(r"(otmcp report \S+)", " ".join(outcome.output.split()))
    return list(dict.fromkeys(found))


@pytest.mark.long
def test_every_command_that_a_report_prints_works(empty_repository: Repository) -> None:
    repository = empty_repository
    repository.subject("wrong-value")
    outcome = repository.pytest("--pyargs", "pytest_otmcp.conformance", "--otmcp-reps=1", "-k", "[M2] or [M1]")
    commands = printed(outcome)
    assert {" ".join(command.split()[:2]) for command in commands} >= {"otmcp verify", "otmcp explain", "otmcp report"}
    assert any("-k '[M2]'" in command for command in commands)
    refused = {}
    for command in commands:
        program, *arguments = shlex.split(command)
        # The page names the record beside itself, the terminal names it from the directory of the run.
        where = outcome.report if "run.json" in arguments else repository.root
        done = run(PROGRAMS[program], arguments, where)
        # A command that cannot be carried out ends with 2; a failing record is a failure all the same.
        if done.returncode not in (0, 1) or (program == "pytest" and "VERDICT: " not in done.stdout):
            refused[command] = done.stdout + done.stderr
    assert refused == {}


def run(program: list[str], arguments: list[str], where: Path) -> subprocess.CompletedProcess[str]:
    """Run a command as somebody would who read it."""
    environment = {**os.environ, "COLUMNS": "80"}
    return subprocess.run(
        [*program, *arguments], cwd=where, env=environment, capture_output=True, text=True, timeout=300, check=False
    )
