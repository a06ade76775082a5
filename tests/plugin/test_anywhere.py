"""``pytest --otmcp-…`` finds the shipped suite wherever the kit is installed, whatever the repository is like."""

from __future__ import annotations

import re

import pytest

from pytest_otmcp.plugin.collection import suite_root
from pytest_otmcp.suite.catalogue import tasks_by_id

from .vendor import Repository

OWN_TEST = "def test_own():\n    pass\n"
NAMESAKE = """
import pytest

@pytest.mark.parametrize("task", ["M1", "R-mqtt"])
def test_normal(task):
    pass
"""
HOSTILE_INI = """
[pytest]
testpaths = tests
python_files = check_*.py
python_functions = check_*
python_classes = Check*
norecursedirs = * conformance
filterwarnings = error
asyncio_mode = auto
asyncio_default_fixture_loop_scope = session
asyncio_default_test_loop_scope = session
addopts = --strict-markers --import-mode=importlib
"""


@pytest.fixture
def repository(empty_repository: Repository) -> Repository:
    """A vendor's repository with a test of the vendor's own."""
    empty_repository.write(tests__test_own_py=OWN_TEST)
    return empty_repository


@pytest.fixture(scope="module")
def suite() -> list[str]:
    """Names of the items of the shipped suite, in its order."""
    return [f"test_{task.suite}[{identifier}]" for identifier, task in tasks_by_id().items()]


def test_an_option_of_the_kit_alone_means_the_shipped_suite(repository: Repository, suite: list[str]) -> None:
    assert repository.collected("--otmcp-reps=30") == suite


def test_without_an_option_of_the_kit_nothing_of_it_is_collected(repository: Repository) -> None:
    assert repository.collected() == ["test_own"]


def test_options_in_the_ini_do_not_turn_everybodys_test_run_into_a_conformance_run(repository: Repository) -> None:
    repository.write(pytest_ini="[pytest]\notmcp_reps = 30\naddopts = --otmcp-suite=normal\n")
    assert repository.collected() == ["test_own"]


def test_own_tests_that_are_named_run_with_the_kits_options(repository: Repository) -> None:
    assert repository.collected("--otmcp-reps=2", "tests") == ["test_own"]


def test_own_tests_and_the_suite_can_be_named_together(repository: Repository, suite: list[str]) -> None:
    assert repository.collected("tests", "--pyargs", "pytest_otmcp.conformance") == ["test_own", *suite]


@pytest.mark.long
def test_no_ini_keeps_anything_of_the_suite_from_being_collected(repository: Repository, suite: list[str]) -> None:
    repository.write(pytest_ini=HOSTILE_INI, conftest_py='collect_ignore_glob = ["*"]\n')
    assert repository.collected("--otmcp-reps=1", plugins="pytest_asyncio.plugin anyio") == suite
    assert repository.collected("--pyargs", "pytest_otmcp.conformance", plugins="pytest_asyncio.plugin anyio") == suite


def test_broken_tests_of_the_vendor_are_not_in_the_way(repository: Repository, suite: list[str]) -> None:
    repository.write(tests__test_broken_py="import there_is_no_such_module\n")
    assert repository.collected("--otmcp-suite=normal,fault,stress,recovery") == suite


@pytest.mark.long
def test_the_whole_suite_runs_in_a_hostile_repository_on_two_workers(repository: Repository, suite: list[str]) -> None:
    repository.write(pytest_ini=HOSTILE_INI)
    repository.reference_subject()
    outcome = repository.pytest("--otmcp-reps=1", "-n", "2", plugins="xdist pytest_asyncio.plugin anyio")
    assert outcome.code == 0, outcome.output
    assert "VERDICT: CONFORMANT" in outcome.output
    assert "latencies withheld" in outcome.output
    # Withheld means: also in the rows that appear while the items run.
    assert re.search(r"^  M1 +1/1 PASS Ping the adapter", outcome.output, re.MULTILINE)
    assert not re.search(r"\d ms", outcome.output)
    assert outcome.record["footer"]["timing_valid"] is False
    assert [f"test_{item['suite']}[{item['id']}]" for item in outcome.record["items"]] == suite
    assert outcome.narrowed == []
    assert set(outcome.record["subject"]["adapters"]) == {"modbus", "mqtt", "opcua"}


@pytest.mark.long
def test_own_tests_that_are_called_like_a_task_are_no_conformance_run_on_two_workers(repository: Repository) -> None:
    repository.write(tests__test_normal_py=NAMESAKE)
    outcome = repository.pytest("-n", "2", plugins="xdist")
    assert outcome.code == 0, outcome.output
    assert "3 passed" in outcome.output
    assert "VERDICT" not in outcome.output


@pytest.mark.long
def test_a_file_of_the_suite_can_be_named_by_its_path_on_two_workers(repository: Repository) -> None:
    repository.subject()
    path = suite_root() / "test_normal.py"
    repository.write(pytest_ini="[pytest]\n")
    options = ["-c", "pytest.ini", "--otmcp-reps=1", "-k", "M1 or M2", "-n", "2"]
    outcome = repository.pytest(str(path), *options, plugins="xdist")
    assert [item["id"] for item in outcome.record["items"]] == ["M1", "M2"]
    assert outcome.code == 1, outcome.output
    assert "VERDICT: INCOMPLETE" in outcome.output
    calls = outcome.record["subject"]["adapters"]["modbus"]["calls"]
    # M1 and M2 have a worker each; what neither asked for is there, and no tool of it was called.
    assert calls["ping"]
    assert calls["read_input_registers"]
    assert calls["mask_write_register"] == 0


@pytest.mark.long
def test_the_time_of_a_run_counts_from_the_beginning_of_the_session(repository: Repository) -> None:
    repository.subject()
    # The conftest sets the monotonic clock forward: according to it, the session began 1000 seconds ago.
    repository.write(
        conftest_py="import time\n\nBEGUN = time.monotonic\n\n"
        "def pytest_sessionstart():\n    time.monotonic = lambda: BEGUN() + 1000.0\n"
    )
    outcome = repository.pytest("--otmcp-reps=1", "-k", "[M1]")
    assert outcome.record["footer"]["elapsed_s"] > 1000


def test_a_bad_subject_file_is_said_in_a_sentence_and_ends_the_run_with_code_2(repository: Repository) -> None:
    repository.write(otmcp_toml="[subject\n")
    for options in (["--otmcp-reps=1"], ["--otmcp-reps=1", "-n", "2"]):
        outcome = repository.pytest(*options, plugins="xdist")
        assert outcome.code == 2, outcome.output
        assert "otmcp.toml: not valid TOML" in outcome.output
        assert "Traceback" not in outcome.output
        assert "INTERNALERROR" not in outcome.output


def test_a_bad_subject_file_does_not_matter_to_tests_that_do_not_ask_for_it(repository: Repository) -> None:
    repository.write(otmcp_toml="[subject\n")
    assert repository.pytest().code == 0


def test_help_is_printed_whatever_the_ini_says(repository: Repository) -> None:
    repository.write(pytest_ini="[pytest]\notmcp_reps = many\n")
    assert repository.pytest("--help").code == 0
    assert repository.pytest().code == 2
