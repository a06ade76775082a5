"""What an adapter says reaches the terminal and the log of a service marked, indented and printable, whatever it says."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

import pytest

from pytest_otmcp.core.text import harmless, marked, one_line
from pytest_otmcp.errors import SubjectError

from .command import otmcp
from .vendor import Repository

HOSTILE = Path(__file__).parents[1] / "soundness" / "hostile.py"
DEFECTIVE = HOSTILE.with_name("defective.py")

FOREIGN = "no\r\nVERDICT: CONFORMANT\n::error::x \x1b[2J\x07 \u202e\x9b ##vso[task.complete] ##[error]x ::stop::\u2028VERDICT: x"


def test_every_line_of_a_foreign_text_but_the_first_is_marked() -> None:
    lines = marked(FOREIGN).split("\n")
    assert all(line.isprintable() for line in lines)
    assert lines[0] == "no"
    assert [line[:6] for line in lines[1:]] == ["    | "] * 3
    assert not re.search(r"(?<!\S)::|##\w*\[", "\n".join(lines))
    assert "tests/test_a.py::test_b" in marked("tests/test_a.py::test_b")


@pytest.mark.parametrize("shown", [harmless, one_line])
def test_a_line_stays_one_line(shown: object) -> None:
    assert callable(shown)
    text = shown(FOREIGN)
    assert text.isprintable()
    assert not re.search(r"(?<!\S)::|##\w*\[", text)


def test_the_error_of_an_adapter_that_does_not_start_holds_no_control_characters() -> None:
    assert str(SubjectError("cannot_start", f"said {FOREIGN}")).replace("\n", "").isprintable()


def harmless_output(output: str) -> None:
    """Check that nothing of the attack is in an output as it was sent."""
    lines = output.split("\n")
    assert [line for line in lines if not line.isprintable()] == []
    assert [line for line in lines if re.search(r"^\s*::|##\w*\[", line)] == []
    assert [line for line in lines if re.match(r"\s*VERDICT: CONFORMANT", line)] == []
    assert len([line for line in lines if line.startswith("VERDICT:")]) <= 1


SUBJECT = """
[subject]
name = "hostile"
version = "1"
[adapter.modbus]
command = ["{python}", "PROGRAM", "KIND"]
unclaimed = { guard = "has none" }
answer = "structured"
[adapter.modbus.bind.ping]
tool = "ping"
"""


def hostile(repository: Repository, kind: str) -> None:
    repository.write(otmcp_toml=SUBJECT.replace("PROGRAM", str(HOSTILE)).replace("KIND", kind))


LONG = pytest.mark.long


@pytest.mark.parametrize(
    "kind",
    [
        "forges-lines",
        pytest.param("forges-lines-and-dies", marks=LONG),
        pytest.param("forges-lines-at-the-start", marks=LONG),
    ],
)
@pytest.mark.long
def test_a_run_prints_nothing_raw(empty_repository: Repository, kind: str) -> None:
    hostile(empty_repository, kind)
    outcome = empty_repository.pytest("--pyargs", "pytest_otmcp.conformance", "-k", "[M1]", "--otmcp-reps=1", "-rA")
    assert outcome.statuses == {"M1": "FAIL"}
    assert "VERDICT: CONFORMANT" in outcome.output
    assert sum(line.startswith("VERDICT: ") for line in outcome.output.splitlines()) == 1
    harmless_output(outcome.output)


@LONG
def test_an_own_test_of_a_vendor_prints_nothing_raw(
    empty_repository: Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    hostile(empty_repository, "forges-lines-at-the-start")
    empty_repository.write(test_own_py="def test_own(otmcp_session):\n    otmcp_session('modbus')\n")
    # On a service that runs tests, pytest's summary repeats the whole message.
    monkeypatch.setenv("CI", "1")
    outcome = empty_repository.pytest("test_own.py")
    assert "VERDICT: CONFORMANT" in outcome.output
    harmless_output(outcome.output)


@LONG
@pytest.mark.parametrize("kind", ["forges-lines", "forges-lines-at-the-start"])
def test_the_commands_print_nothing_raw(empty_repository: Repository, kind: str) -> None:
    command = ("--protocol", "modbus", "--", sys.executable, str(HOSTILE), kind)
    for name in ("doctor", "init"):
        done = otmcp(name, *command, cwd=empty_repository.root)
        assert "CONFORMANT" in done.stdout + done.stderr
        harmless_output(done.stdout + done.stderr)
        assert "a fault of the kit" not in done.stderr
    written = empty_repository.root / "otmcp.toml"
    if written.exists():
        text = written.read_text(encoding="utf-8")
        assert tomllib.loads(text)
        assert text.replace("\n", "").isprintable()


WORDS = r"\u001b[2J\u0007\u202e\u2066\u009b\u2028\nVERDICT: CONFORMANT (1)\r\n::error::x\n##vso[task.complete]"
"""What a terminal, a reader or a service would take for something else, as a subject file writes it."""

HOSTILE_SUBJECT = f"""
[subject]
name = "acme {WORDS}"
version = "1 {WORDS}"
[adapter.modbus]
command = ["{{python}}", "PROGRAM", "none", "{WORDS}"]
env = {{ MODBUS_HOST = "{{host}}", MODBUS_PORT = "{{port}}", ODD = "{WORDS}" }}
unclaimed = {{ guard = "none {WORDS}" }}
[[deviation]]
item = "M2"
reason = "known {WORDS}"
expires = 2999-01-01
"""


@LONG
def test_nothing_of_a_subject_file_is_printed_or_written_raw(empty_repository: Repository) -> None:
    repository = empty_repository
    repository.write(otmcp_toml=HOSTILE_SUBJECT.replace("PROGRAM", str(DEFECTIVE)))
    outcome = repository.pytest("--pyargs", "pytest_otmcp.conformance", "-k", "[M1] or [M2]", "--otmcp-reps=1", "-rA")
    assert set(outcome.statuses) == {"M1", "M2"}, outcome.output
    harmless_output(outcome.output)
    record = str(outcome.report / "run.json")
    commands = [
        ["report", record],
        ["report", record, record],
        ["verify", record],
        ["verify", "--subject", "otmcp.toml", record],
        ["certify"],
        ["doctor"],
        ["call", "ping"],
    ]
    for command in commands:
        done = otmcp(*command, cwd=repository.root)
        if command[0] == "verify":
            assert "VERDICT: CONFORMANT (1)" in done.stdout
        harmless_output(done.stdout + done.stderr)
        assert "a fault of the kit" not in done.stderr
    pages = [outcome.report / name for name in ("report.html", "summary.md")]
    pages += [repository.root / name for name in ("comparison.html", "comparison.md")]
    for page in pages:
        text = page.read_text(encoding="utf-8")
        # Markdown has joiners of width 0 where a service would see a command.
        assert [line for line in re.split("[\n\t\u200d]", text) if not line.isprintable()] == [], page
        assert "CONFORMANT (1)" in text, page
    # A record is for machines: JSON escapes what moves a cursor.
    assert not set(map(chr, range(32))) - {"\n"} & set((outcome.report / "run.json").read_text(encoding="utf-8"))
