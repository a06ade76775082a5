"""Nothing in a vendor's repository changes a result silently: the record says what narrowed or shadowed the suite."""

from __future__ import annotations

import pytest

from .vendor import Outcome, Repository

MEDDLING = """
import pytest

@pytest.fixture(autouse=True)
def around_everything():
    yield

@pytest.fixture
def _otmcp_trial(_otmcp_trial):
    def run(task):
        try:
            _otmcp_trial(task)
        except BaseException:
            pass
    return run

def pytest_collection_modifyitems(items):
    items[:] = [item for item in items if "[M3]" not in item.nodeid]
    for item in items:
        if "[M4]" in item.nodeid:
            item.add_marker(pytest.mark.skip(reason="not now"))
    items.reverse()
    items.append(items[-1])
"""
FLATTERING = """
import pytest

@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    report.outcome = "passed"
    report.longrepr = None
    return report
"""
FORGING = """
import pytest
from pytest_otmcp.trial import expectations

@pytest.fixture(autouse=True)
def forgive(monkeypatch):
    monkeypatch.setattr(expectations, "succeeded", lambda reply, **outputs: [])
"""
BRIBING = """
import pytest
from pytest_otmcp.plant.mock_device import MockDevice

@pytest.fixture(autouse=True)
def bribe(monkeypatch):
    true = MockDevice.image

    async def image(self):
        return await true(self)

    monkeypatch.setattr(MockDevice, "image", image)
"""
ALTERING = """
async def nothing(run, modbus):
    pass

def pytest_collection_modifyitems(items):
    for item in items:
        task = item.callspec.params["task"]
        if task.id == "M2":
            task.position = 99
        if task.id == "S7":
            task.steps = nothing
"""
LAST_WORD = """
import pytest

@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(items):
    yield
    del items[1:]
"""
AGAIN = """
from _pytest.runner import runtestprotocol

def pytest_runtest_protocol(item, nextitem):
    runtestprotocol(item, nextitem=nextitem)
    item._initrequest()
    runtestprotocol(item, nextitem=nextitem)
    return True
"""
EMPTY = "def pytest_pyfunc_call(pyfuncitem):\n    return True\n"


@pytest.fixture
def repository(empty_repository: Repository) -> Repository:
    """A repository with an adapter that reports wrong register values."""
    empty_repository.subject("wrong-value")
    return empty_repository


def only(outcome: Outcome, *parts: str) -> None:
    """Expect each part in a sentence of the record and on the terminal, and no other sentences."""
    for part in parts:
        assert any(part in sentence for sentence in outcome.narrowed), outcome.narrowed
    assert len(outcome.narrowed) == len(parts), outcome.narrowed
    words = " ".join(outcome.output.split())
    for sentence in outcome.narrowed:
        assert f"narrowed: {sentence}" in words


@pytest.mark.long
def test_a_run_that_nothing_bends_has_nothing_to_say(repository: Repository) -> None:
    outcome = repository.pytest("--otmcp-reps=1")
    assert outcome.narrowed == []
    assert outcome.statuses["M1"] == "PASS"
    assert outcome.statuses["M2"] == "FAIL"
    assert outcome.record["footer"]["complete"] is True
    assert outcome.code == 1


@pytest.mark.long
def test_a_conftest_that_shadows_removes_skips_reverses_and_repeats_changes_no_result(repository: Repository) -> None:
    repository.write(conftest_py=MEDDLING)
    outcome = repository.pytest("--otmcp-reps=1")
    assert outcome.code == 1
    assert outcome.verdict == "NOT CONFORMANT"
    assert outcome.statuses["M2"] == "FAIL"
    assert "M4" not in outcome.statuses
    assert [*outcome.statuses][:3] == ["M1", "M2", "Q1"]
    assert outcome.record["footer"]["reason"] == "2 of 11 items did not run: M3, M4"
    only(
        outcome,
        "the fixture around_everything of conftest.py:4 runs around the items",
        "the fixture _otmcp_trial of conftest.py:8 shadows the kit's",
        "1 of 38 items were taken out by conftest.py: M3",
        "items are marked skip by something outside the suite",
        "FM1 would run more than once; the first time counts",
        "the kit did not execute these items, whatever pytest reports of them: test_fault[FM1]",
        "a conftest or plugin changed what pytest reports of items, not their results: M2 passed for FAIL, ",
    )


@pytest.mark.long
def test_a_plugin_that_reports_only_success_changes_neither_verdict_nor_exit_code(repository: Repository) -> None:
    repository.write(flattering_py=FLATTERING)
    for parallel in ((), ("-n", "2")):
        outcome = repository.pytest(
            "--otmcp-reps=1", "-p", "flattering", *parallel, plugins="xdist", path=(repository.root,)
        )
        assert outcome.code == 1, outcome.output
        assert outcome.verdict == "NOT CONFORMANT"
        assert "flattering.py has a hook around the items: pytest_runtest_makereport" in outcome.narrowed
        [changed] = [sentence for sentence in outcome.narrowed if "not their results" in sentence]
        assert "M2 passed for FAIL" in changed


def test_items_that_a_plugin_says_were_run_did_not_run(repository: Repository) -> None:
    repository.write(empty_py=EMPTY)
    outcome = repository.pytest("--otmcp-reps=1", "-p", "empty", path=(repository.root,))
    assert outcome.code == 1
    assert "VERDICT: INCOMPLETE (no item of the suite ran)" in outcome.output
    assert "the kit did not execute these items, whatever pytest reports of them: test_normal[M1]" in outcome.output
    assert not (outcome.report / "run.json").exists()


@pytest.mark.long
def test_a_task_that_is_not_as_its_module_declares_it_is_on_record(repository: Repository) -> None:
    repository.write(conftest_py=ALTERING)
    outcome = repository.pytest("--otmcp-reps=1", "-k", "M2 or S7")
    assert outcome.statuses["S7"] == "PASS"
    assert "position of the task M2 was altered from None to 99" in outcome.narrowed
    assert any("steps of the task S7 were replaced by something from" in sentence for sentence in outcome.narrowed)
    assert outcome.code == 1


@pytest.mark.long
def test_whoever_has_the_last_word_on_the_items_is_noticed(repository: Repository) -> None:
    repository.write(conftest_py=LAST_WORD)
    outcome = repository.pytest("--otmcp-reps=1")
    only(outcome, "items were taken out behind the kit's back: M2, M3, M4, Q1, Q2, Q3 and 31 more")
    assert outcome.verdict == "INCOMPLETE"


@pytest.mark.long
def test_of_several_attempts_the_first_counts(repository: Repository) -> None:
    repository.write(again_py=AGAIN)
    outcome = repository.pytest("--otmcp-reps=1", "-k", "[M1] or [M2]", "-p", "again", path=(repository.root,))
    assert outcome.statuses == {"M1": "PASS", "M2": "FAIL"}
    assert "items ran more than once, the first time counts: M1, M2" in outcome.narrowed


@pytest.mark.parametrize(
    ("conftest", "replaced"),
    [
        pytest.param(FORGING, "trial.expectations.succeeded", marks=pytest.mark.long),
        pytest.param(BRIBING, "plant.mock_device.MockDevice.image", marks=pytest.mark.long),
    ],
)
def test_a_replaced_function_of_the_kit_is_on_record(repository: Repository, conftest: str, replaced: str) -> None:
    repository.write(conftest_py=conftest)
    outcome = repository.pytest("--otmcp-reps=1", "-k", "[M1]")
    assert any(
        sentence.startswith(f"pytest_otmcp.{replaced} was replaced by something from")
        and sentence.endswith("conftest.py")
        for sentence in outcome.narrowed
    )


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (
            ("-k", "[M1] or [Q1]"),
            "36 of 38 items were taken out by -k [M1] or [Q1]: M2, M3, M4, Q2, Q3, Q4 and 30 more",
        ),
        pytest.param(
            ("-m", "otmcp_stress and not otmcp_modbus"),
            "by -m otmcp_stress and not otmcp_modbus: ",
            marks=pytest.mark.long,
        ),
        pytest.param(
            ("--otmcp-suite=normal", "-k", "[M1]"),
            "only the suite normal was asked for (--otmcp-suite)",
            marks=pytest.mark.long,
        ),
        pytest.param(
            ("--otmcp-time-scale=2", "-k", "[M1]"), "multiplied by 2 (--otmcp-time-scale)", marks=pytest.mark.long
        ),
        pytest.param(
            ("--pyargs", "pytest_otmcp.conformance.test_normal", "-k", "[M1]"),
            "22 of 38 items were not collected: pytest was asked for",
            marks=pytest.mark.long,
        ),
        pytest.param(
            ("-x", "--otmcp-suite=normal"),
            "the run ended at failure number 1 (-x or --maxfail)",
            marks=pytest.mark.long,
        ),
    ],
)
def test_what_was_asked_for_is_on_record_as_well(
    repository: Repository, options: tuple[str, ...], sentence: str
) -> None:
    outcome = repository.pytest("--otmcp-reps=1", *options)
    assert any(sentence in noted for noted in outcome.narrowed), outcome.narrowed
    assert outcome.record["footer"]["complete"] is False
    assert outcome.verdict in ("INCOMPLETE", "NOT CONFORMANT")
    assert outcome.code == 1


@pytest.mark.long
def test_a_filter_in_the_ini_is_told_from_one_on_the_command_line(repository: Repository) -> None:
    repository.write(pytest_ini="[pytest]\naddopts = -k [M1]\n")
    outcome = repository.pytest("--otmcp-reps=1")
    only(outcome, "by -k [M1] (not from the command line): M2, M3")
    assert outcome.verdict == "INCOMPLETE"
    assert outcome.code == 1


@pytest.mark.long
def test_a_copy_of_the_suite_is_not_the_suite(repository: Repository) -> None:
    copy = "from pytest_otmcp.conformance.test_normal import *  # with whatever changes\n"
    repository.write(tests__test_copy_py=copy)
    outcome = repository.pytest("--otmcp-reps=1", "tests", "--pyargs", "pytest_otmcp.conformance", "-k", "[M1]")
    assert list(outcome.statuses) == ["M1"]
    assert "tests/test_copy.py::test_normal[M1] is not of the shipped suite and is not counted" in outcome.narrowed


WITHOUT_SNAP7 = """
from importlib import metadata

installed = metadata.version

def version(name):
    if name == "python-snap7":
        raise metadata.PackageNotFoundError(name)
    return installed(name)

metadata.version = version
"""


def test_an_item_of_a_protocol_without_its_library_says_what_to_install(empty_repository: Repository) -> None:
    empty_repository.write(uninstalled_py=WITHOUT_SNAP7)
    path = (empty_repository.root,)
    outcome = empty_repository.pytest("-p", "uninstalled", "--otmcp-protocols=all", "-k", "K1", path=path)
    said = "note: S7comm was not measured: python-snap7 is not installed; pip install 'pytest-otmcp[s7]'"
    assert said in outcome.output.splitlines()
    assert "VERDICT: INCOMPLETE (no item of the suite ran)" in outcome.output
    assert outcome.code == 5


def test_nothing_left_of_the_suite_is_no_success(repository: Repository) -> None:
    repository.write(
        conftest_py="def pytest_collection_modifyitems(items):\n"
        "    items[:] = [item for item in items if 'own' in item.nodeid]\n",
        tests__test_own_py="def test_own():\n    pass\n",
    )
    outcome = repository.pytest("--otmcp-reps=1", "tests", "--pyargs", "pytest_otmcp.conformance")
    assert "1 passed" in outcome.output
    assert "VERDICT: INCOMPLETE (no item of the suite ran)" in outcome.output
    assert "38 of 38 items were taken out by conftest.py" in outcome.output
    assert outcome.code == 1
