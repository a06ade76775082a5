"""The words of the command line that argcomplete offers: its part in the shell runs the program and reads them from descriptor 8."""

from __future__ import annotations

import os
import sys
import sysconfig
import tempfile
from pathlib import Path

import pytest

OTMCP = Path(sysconfig.get_path("scripts"), "otmcp")


def offered(line: str) -> set[str]:
    """Return the words that may come next in a line of the shell."""
    environment = {
        **os.environ,
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    with tempfile.TemporaryFile() as answer:
        redirected = [(os.POSIX_SPAWN_DUP2, answer.fileno(), 8)]
        command = [sys.executable, str(OTMCP)]
        process = os.posix_spawn(sys.executable, command, environment, file_actions=redirected)
        assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0
        answer.seek(0)
        return set(answer.read().decode().split("\n"))


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("otmcp self", {"self-check"}),
        ("otmcp explain ", {"M3", "WR-003", "WR-003.modbus", "Bronze", "mb-w", "illegal_address", "wrong_value"}),
        ("otmcp docs ", {"subject-file", "fixtures", "checks"}),
    ],
)
def test_the_shell_is_offered(line: str, expected: set[str]) -> None:
    assert expected <= offered(line)


def test_the_shell_is_offered_what_begins_alike_and_nothing_else() -> None:
    found = offered("otmcp explain WR-00")
    assert "WR-003" in found
    assert all(word.startswith("WR-00") for word in found)
