"""Every command that a document prints is one that its program takes, and of every kind some test runs one.

The commands of reports are run word for word by ``tests/plugin/test_printed_commands.py``.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from importlib.util import find_spec

import pytest

from pytest_otmcp import cli

from .test_documentation import CHECKOUT, WRITTEN

RUN_BY = {
    "otmcp init": "tests/plugin/test_init.py",
    "otmcp doctor": "tests/plugin/test_init.py",
    "otmcp call": "tests/plugin/test_call.py",
    "otmcp console": "tests/console/test_command.py",
    "otmcp assess": "tests/assess/test_command.py",
    "otmcp mock": "tests/plugin/test_cli.py",
    "otmcp docs": "tests/house/test_documentation.py",
    "otmcp explain": "tests/unit/test_explain.py",
    "otmcp report": "tests/plugin/test_printed_commands.py",
    "otmcp certify": "tests/plugin/test_certification.py",
    "otmcp verify": "tests/plugin/test_certification.py",
    "otmcp judge": "tests/plugin/test_cli.py",
    "otmcp fleet": "tests/fleet/test_running.py",
    "otmcp merge": "tests/fleet/test_merge.py",
    "otmcp self-check": "tests/plugin/test_self_check.py",
    "pytest": "tests/plugin/test_runs.py",
    "uvx": "tests/packaging/test_tools.py",
    "uv tool": "tests/packaging/test_tools.py",
    "pipx install": "tests/packaging/test_tools.py",
    "just": "tests/house/test_commands.py",
    "python -m pytest_otmcp.reference_adapters": "tests/adapters/conftest.py",
    "python -m pytest_otmcp.mocks": "tests/mocks/conftest.py",
    "python -m benchmarks.fleet_scale": "tests/fleet/test_scale.py",
    "python -m tests.adapters_in_the_wild.field_report": "tests/adapters_in_the_wild/test_field_report.py",
}
"""What a command begins with, and the tests that run such a command."""

_PROGRAM = re.compile(r"(?:otmcp|pytest|just|uvx|uv tool|pipx install|python -m) \S")
_REDIRECTED = re.compile(r"\s(?:[<>&] ?\S*|#).*")


def commands(text: str) -> Iterator[str]:
    """Yield the commands of a page: those in blocks for a shell, and those in the line."""
    for block in re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        for line in block.splitlines():
            yield from re.split(r" && |; do |; done|\s#", line)
    yield from re.findall(r"`+((?:\.venv/bin/)?[a-z]+ [^`\n]+)`+", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S))


def printed() -> dict[str, str]:
    """Return every command of a program of the kit with the page that prints it, without its path in an environment."""
    found = {}
    for page in WRITTEN:
        if page.name != "CHANGELOG.md":
            for line in commands(page.read_text(encoding="utf-8")):
                command = re.sub(r"^(?:[A-Z_]+=\S+ )+", "", _REDIRECTED.sub("", line).strip()).replace(
                    "python3 -m", "python -m"
                )
                command = command.removeprefix(".venv/bin/")
                if _PROGRAM.match(command):
                    found[command.replace("\\|", "|")] = str(page.relative_to(CHECKOUT))
    return found


COMMANDS = printed()


def taken(program: str) -> list[str]:
    """Return the commands of a program that are whole: a form with brackets or dots is no command yet."""
    return [one for one in COMMANDS if one.startswith(f"{program} ") and not re.search(r"…|\[\w|\.\.\.", one)]


def test_there_are_many() -> None:
    assert len(COMMANDS) > 90


def test_every_kind_of_command_is_run_by_a_test() -> None:
    missing = {
        command: page for command, page in COMMANDS.items() if not command.startswith((*RUN_BY, "python -m venv"))
    }
    assert missing == {}
    assert [path for path in RUN_BY.values() if not (CHECKOUT / path).is_file()] == []


@pytest.mark.parametrize("command", taken("otmcp"))
def test_otmcp_takes_every_command_that_is_printed(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        cli._parser().parse_args(shlex.split(command.replace("PROTOCOL", "modbus"))[1:])
    except SystemExit:
        # A sentence may name a command without what it works on.
        assert "error: the following arguments are required: " in capsys.readouterr().err


def test_pytest_takes_every_option_that_is_printed(pytestconfig: pytest.Config) -> None:
    for command in taken("pytest"):
        arguments = shlex.split(command)[1:]
        pytestconfig._parser.parse(arguments)
        paths = [one for one in arguments if one.startswith(("tests/", "benchmarks"))]
        assert [path for path in paths if not (CHECKOUT / path).exists()] == [], command


def test_just_has_every_recipe_that_is_printed() -> None:
    recipes = set(re.findall(r"^([a-z]+)(?: [^:\n]*)?:", (CHECKOUT / "justfile").read_text(encoding="utf-8"), re.M))
    assert {command.split()[1] for command in COMMANDS if command.startswith("just ")} <= recipes


def test_python_finds_every_module_that_is_printed() -> None:
    modules = {command.split()[2] for command in taken("python")} - {"venv"}
    # In a checkout three rooms lie beside the package that has them in the wheel.
    rooms = r"^pytest_otmcp\.(mocks|reference_adapters|conformance)"
    assert [name for name in modules if find_spec(re.sub(rooms, r"\1", name)) is None] == []
