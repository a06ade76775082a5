"""The exit codes of pytest: 0 conformant, 1 not conformant, 2 usage error or interrupted, 3 a fault of the kit."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import pytest

from pytest_otmcp.protocols.registry import protocols

from .vendor import Repository

BROKEN_KIT = """
import pytest

from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.trial import trial

async def broken(self):
    raise RuntimeError("a bug")

@pytest.fixture(autouse=True)
def break_the_kit(monkeypatch):
    monkeypatch.setattr(trial.Trial, "run", broken)
"""


@pytest.fixture
def repository(empty_repository: Repository) -> Repository:
    """An empty repository."""
    return empty_repository


def deviations(items: list[str], expires: str) -> str:
    """Return known deviations as a subject file has them."""
    return "".join(f'\n[[deviation]]\nitem = "{item}"\nreason = "known"\nexpires = {expires}\n' for item in items)


@pytest.mark.long
def test_known_deviations_make_the_exit_code_green_and_not_the_verdict(repository: Repository) -> None:
    repository.subject("wrong-value")
    first = repository.pytest("--otmcp-reps=1")
    assert first.code == 1
    failing = [item for item, status in first.statuses.items() if status == "FAIL"]
    assert failing

    repository.subject("wrong-value", more=deviations(failing, "2999-01-01"))
    excused = repository.pytest("--otmcp-reps=1", "--junit-xml=junit.xml")
    assert excused.code == 0, excused.output
    assert excused.verdict == "NOT CONFORMANT"
    assert sorted(excused.record["footer"]["deviations"]["used"]) == sorted(failing)
    excuse = f"known deviation {failing[0]} until 2999-01-01: it fails, and is excused from the exit code"
    assert excuse in " ".join(excused.output.split())
    (suite,) = ElementTree.parse(repository.root / "junit.xml").iter("testsuite")
    assert (suite.get("failures"), suite.get("errors")) == ("0", "0")
    expected = [case.get("message") for case in suite.iter("skipped") if case.get("type") == "pytest.xfail"]
    assert expected == ["known deviation until 2999-01-01: known"] * len(failing)
    told = json.loads((excused.report / "verdict.json").read_text())["deviations"]
    assert sorted(one["item"] for one in told) == sorted(failing)

    repository.subject("wrong-value", more=deviations([*failing, "M1"], "2999-01-01"))
    stale = repository.pytest("--otmcp-reps=1", "--junit-xml=junit.xml")
    assert stale.code == 1
    assert stale.record["footer"]["deviations"]["stale"] == ["M1"]
    (suite,) = ElementTree.parse(repository.root / "junit.xml").iter("testsuite")
    (error,) = suite.iter("error")
    assert "known deviation M1: its item passes, and the exit code is 1" in (error.get("message") or "")


@pytest.mark.long
def test_a_conformant_run_beside_a_failure_of_the_vendors_own_is_no_success(repository: Repository) -> None:
    repository.subject()
    repository.write(tests__test_own_py="def test_own():\n    assert False\n")
    alone = repository.pytest("--otmcp-reps=1")
    assert alone.code == 0, alone.output
    together = repository.pytest("--otmcp-reps=1", "tests", "--pyargs", "pytest_otmcp.conformance")
    assert "VERDICT: CONFORMANT" in together.output
    assert together.code == 1


def test_a_bug_of_the_kit_is_neither_success_nor_failure(repository: Repository) -> None:
    repository.subject()
    repository.write(conftest_py=BROKEN_KIT)
    outcome = repository.pytest("--otmcp-reps=1", "-k", "M1")
    assert outcome.code == 3
    assert outcome.statuses["M1"] == "KIT_ERROR", outcome.output
    assert "RuntimeError: a bug. This is the kit's fault; please file a bug." in " ".join(outcome.output.split())
    assert "pytest_otmcp.trial.trial.Trial.run was replaced by something from" in " ".join(outcome.narrowed)


IMPORTED_LATE = """
import threading
import pytest

from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.plugin import worker
from pytest_otmcp.trial.bench import Bench

started, imported = threading.Event(), threading.Event()
prepare, import_ahead, start = Bench.prepare, worker._import_ahead, worker.Run._start

async def prepared(self, *arguments, **named):
    await prepare(self, *arguments, **named)
    started.set()

def late(module):
    started.wait()
    import_ahead(module)
    imported.set()

def checked(self, task):
    found = start(self, task)
    assert imported.is_set()
    return found

@pytest.fixture(autouse=True)
def import_late(monkeypatch):
    monkeypatch.setattr(Bench, "prepare", prepared)
    monkeypatch.setattr(worker, "_import_ahead", late)
    monkeypatch.setattr(worker.Run, "_start", checked)
"""


@pytest.mark.long
def test_no_item_begins_beside_an_import(repository: Repository) -> None:
    # Two threads that parse at the same time fail now and then before Python 3.11.8 and 3.12.2: an item was a fault of the kit.
    repository.subject()
    repository.write(conftest_py=IMPORTED_LATE)
    outcome = repository.pytest("--otmcp-reps=1", "-k", "[M1]")
    assert outcome.statuses == {"M1": "PASS"}, outcome.output


@pytest.mark.long
def test_an_adapter_without_the_tool_that_its_subject_names_is_a_usage_error(repository: Repository) -> None:
    binding = '\n[adapter.modbus.bind.ping]\ntool = "pingg"\nresult = { reachable = "data.reachable" }\n'
    repository.subject(more=binding)
    for parallel in ((), ("-n", "2")):
        outcome = repository.pytest("--otmcp-reps=1", *parallel, plugins="xdist")
        assert outcome.code == 2, outcome.output
        assert "the adapter lists no tool 'pingg'; did you mean 'ping'?" in outcome.output
        assert "VERDICT" not in outcome.output
        assert "Traceback" not in outcome.output


def test_a_refused_run_is_an_error_in_its_junit_file(repository: Repository) -> None:
    repository.write(otmcp_toml='[subject]\nnaem = "typing"\n')
    outcome = repository.pytest("--otmcp-reps=1", "--junit-xml=junit.xml")
    assert outcome.code == 2, outcome.output
    (suite,) = ElementTree.parse(repository.root / "junit.xml").iter("testsuite")
    (error,) = suite.iter("error")
    assert (suite.get("tests"), suite.get("errors")) == ("1", "1")
    assert "subject.naem: unknown key; did you mean 'name'?" in (error.get("message") or "")


def test_a_run_without_an_item_is_an_error_in_its_junit_file(repository: Repository) -> None:
    repository.subject()
    outcome = repository.pytest("--otmcp-reps=1", "-k", "no_item_of_this_name", "--junit-xml=junit.xml")
    assert outcome.code == 5, outcome.output
    (suite,) = ElementTree.parse(repository.root / "junit.xml").iter("testsuite")
    (error,) = suite.iter("error")
    assert error.get("message") == "INCOMPLETE: no item of the suite ran"


@pytest.mark.long
def test_a_run_that_ends_at_its_first_failure_was_interrupted_by_nobody(repository: Repository) -> None:
    repository.subject("wrong-value")
    outcome = repository.pytest("--otmcp-reps=1", "-x", "-n", "1", plugins="xdist")
    assert outcome.code == 1, outcome.output
    assert "interrupted" not in outcome.output
    assert any("the run ended at failure number 1" in noted for noted in outcome.narrowed)


@pytest.mark.long
def test_a_subject_file_that_claims_nothing_is_told_what_to_bind(repository: Repository) -> None:
    unclaimed = "\n".join(f'{name} = "not known yet"' for name in protocols()["modbus"].operations)
    repository.write(
        otmcp_toml='[subject]\nname = "nothing"\nversion = "1"\n\n[adapter.modbus]\ncommand = ["{python}", "-c", "", "{url}"]\n\n'
        f'[adapter.modbus.unclaimed]\nguard = "not known yet"\n{unclaimed}\n'
    )
    outcome = repository.pytest("--otmcp-reps=1")
    said = " ".join(outcome.output.split())
    assert outcome.verdict == "INDETERMINATE"
    assert "nothing could be asked: bind operations such as modbus.read_holding and modbus.write_holding" in said
    assert outcome.code == 2, outcome.output
