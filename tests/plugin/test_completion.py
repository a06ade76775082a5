"""Words of the command line are completed by argcomplete, whose part in the shell asks the program by a variable."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest

from pytest_otmcp import cli


def offered(monkeypatch: pytest.MonkeyPatch, command: str, argument: str) -> list[str]:
    """Return the words that a command offers for an argument."""
    found: list[str] = []

    def autocomplete(parser: object) -> None:
        choices = next(action.choices for action in parser._actions if action.dest != "help" and action.choices)  # type: ignore[attr-defined]
        action = next(one for one in choices[command]._actions if one.dest == argument)
        found.extend(action.completer(prefix="", parsed_args=None))
        raise SystemExit(0)

    monkeypatch.setenv("_ARGCOMPLETE", "1")
    monkeypatch.setitem(sys.modules, "argcomplete", SimpleNamespace(autocomplete=autocomplete))  # type: ignore[arg-type]
    assert cli.main([]) == 0
    return found


def test_whatever_can_be_explained_is_offered(monkeypatch: pytest.MonkeyPatch) -> None:
    assert {"M3", "WR-003", "WR-003.modbus", "Bronze", "mb-w", "illegal_address", "wrong_value"} <= {
        *offered(monkeypatch, "explain", "id")
    }


def test_the_pages_are_offered(monkeypatch: pytest.MonkeyPatch) -> None:
    assert {"subject-file", "fixtures", "checks"} <= {*offered(monkeypatch, "docs", "page")}
