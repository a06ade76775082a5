"""What a command prints is folded between words on a terminal, and left as it is in a pipe or a log."""

from __future__ import annotations

import io
from collections.abc import Callable

import pytest

from pytest_otmcp import cli
from pytest_otmcp.core.finding import Finding
from pytest_otmcp.core.text import LONGEST_NAME, MARK, folded, recorded_name


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


Shown = Callable[..., tuple[int, str]]


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> Shown:
    """Return a function that carries out a command on a terminal of 40 columns: its exit code, and what is to be seen."""

    def carried_out(*words: str) -> tuple[int, str]:
        stream = Terminal()
        with monkeypatch.context() as patch:
            patch.setenv("COLUMNS", "40")
            patch.setattr("sys.stdout", stream)
            patch.setattr("sys.stderr", stream)
            return cli.main(words), stream.getvalue()

    return carried_out


def test_what_follows_is_indented_below_the_line_that_it_belongs_to() -> None:
    assert folded("  rw: one two three", 12) == ["  rw: one", "    two", "    three"]
    assert folded("short", 12) == ["short"]


def test_no_part_of_a_marked_line_looks_like_a_line_of_the_kit() -> None:
    assert folded(f"    {MARK}VERDICT: CONFORMANT, it says", 24) == [
        f"    {MARK}VERDICT:",
        f"    {MARK}CONFORMANT, it",
        f"    {MARK}says",
    ]


@pytest.mark.parametrize("words", [["explain", "nonsense"], ["docs", "nonsense"], ["verify", "--nonsense-of-mine"]])
def test_a_refusal_is_not_broken_within_a_word(words: list[str], shown: Shown) -> None:
    code, text = shown(*words)
    lines = text.splitlines()
    assert code == 2
    assert max(map(len, lines)) <= 40
    assert lines[-1].startswith("  ")


def test_a_refusal_in_a_log_is_one_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    assert cli.main(["docs", "nonsense"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_page_on_a_terminal_has_its_code_as_it_is_and_no_anchors(shown: Shown) -> None:
    _, fixtures = shown("docs", "fixtures")
    assert '    assert otmcp_modbus_device.image()["units"]["1"]["holding_registers"][1] == 42\n' in fixtures
    assert max(map(len, fixtures.partition("```")[0].splitlines())) <= 40
    _, libraries = shown("docs", "by-library")
    assert "## " in libraries
    assert "<a id=" not in libraries


def test_a_page_in_a_pipe_is_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["docs", "by-library"]) == 0
    assert '<a id="' in capsys.readouterr().out


def test_a_name_of_any_length_fits_into_a_record() -> None:
    assert recorded_name("acme \u202egnitset") == "acme \\u202egnitset"
    assert len(recorded_name("\U000e0001" * 5000)) == LONGEST_NAME


def test_the_message_of_a_finding_that_was_cut_off_is_not_cut_again() -> None:
    cut = Finding(code="json_rpc_error", message="x" * 20_000)
    assert cut.message.endswith("… (20000 characters)")
    assert Finding(code="json_rpc_error", message=cut.message).message == cut.message
