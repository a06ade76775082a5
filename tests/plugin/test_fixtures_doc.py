"""The public fixtures: every example of their documentation runs as printed, whatever runs asynchronous tests."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from .vendor import Outcome, Repository

PAGE = Path(__file__).parents[2] / "docs" / "fixtures.md"
EXAMPLES = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.DOTALL | re.MULTILINE)
TESTS = sum(len(re.findall(r"^(?:async )?def test_", example, re.MULTILINE)) for example in EXAMPLES)
ANYIO = """

@pytest.fixture
def anyio_backend():
    return "asyncio"
"""


@pytest.fixture
def repository(empty_repository: Repository) -> Repository:
    """A repository with the reference adapters as its subject."""
    empty_repository.reference_subject()
    return empty_repository


def run(
    repository: Repository, *options: str, plugins: str, mark: str = "pytest.mark.asyncio", more: str = ""
) -> Outcome:
    """Run all examples, with the given mark on their asynchronous tests; every warning is an error."""
    for number, example in enumerate(EXAMPLES):
        content = example.replace("@pytest.mark.asyncio\n", f"@{mark}\n" if mark else "")
        repository.write(**{f"tests__test_example_{number}_py": content + (more if mark in content else "")})
    return repository.pytest("-W", "error", *options, plugins=plugins)


def all_passed(outcome: Outcome) -> None:
    assert f"{TESTS} passed" in outcome.output, outcome.output
    assert outcome.code == 0, outcome.output
    assert "VERDICT" not in outcome.output


def test_there_are_examples_of_both_kinds() -> None:
    text = "\n".join(EXAMPLES)
    assert "\ndef test_" in text
    assert "\nasync def test_" in text
    for fixture in ("otmcp_modbus_device", "otmcp_broker", "otmcp_opcua_plant", "otmcp_session"):
        assert fixture in text


@pytest.mark.parametrize("options", [(), pytest.param(("-n", "2"), marks=pytest.mark.long)])
@pytest.mark.long
def test_the_examples_run_under_pytest_asyncio_in_strict_mode(repository: Repository, options: tuple[str, ...]) -> None:
    loops = ("-o", "asyncio_mode=strict", "-o", "asyncio_default_fixture_loop_scope=function")
    all_passed(run(repository, *loops, *options, plugins="pytest_asyncio.plugin xdist"))


@pytest.mark.long
def test_the_examples_run_under_pytest_asyncio_in_auto_mode_with_loops_of_other_scopes(repository: Repository) -> None:
    scopes = ("-o", "asyncio_default_fixture_loop_scope=session", "-o", "asyncio_default_test_loop_scope=module")
    all_passed(run(repository, "-o", "asyncio_mode=auto", *scopes, plugins="pytest_asyncio.plugin", mark=""))


@pytest.mark.long
def test_the_examples_run_under_the_plugin_of_anyio(repository: Repository) -> None:
    all_passed(run(repository, plugins="anyio", mark="pytest.mark.anyio", more=ANYIO))
