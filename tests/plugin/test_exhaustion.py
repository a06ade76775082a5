"""A machine that has run out of something is a fault of the kit: one sentence that helps, exit code 3, and no finding."""

from __future__ import annotations

import compileall
import resource
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from .vendor import Outcome, Repository

PROGRAMS = ("", ".conformance", ".mocks", ".reference_adapters")


def compile_all() -> None:
    """Compile every program that runs with a limit, unless that was done.

    Python up to 3.12 cuts a file of byte code off where the limit is, and keeps it: nobody could import the module any more.
    """
    for name in PROGRAMS:
        for folder in import_module(f"pytest_otmcp{name}").__path__:
            assert compileall.compile_dir(folder, quiet=1)


def run(repository: Repository, limit: int, to: int, *options: str) -> Outcome:
    """Run the suite on the reference adapters, cold as a user's, with a limit of the system's."""
    compile_all()
    done = subprocess.run(
        repository.command("--pyargs", "pytest_otmcp.conformance", *options),
        cwd=repository.root,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**repository.environment(), "PYTHONDONTWRITEBYTECODE": "1"},
        preexec_fn=lambda: resource.setrlimit(limit, (to, to)),
    )
    return repository.outcome(done.returncode, done.stdout + done.stderr)


def accuses_nobody(outcome: Outcome) -> None:
    """Check that the run blames neither the adapter nor a bug, and says what helps."""
    assert outcome.code == 3, outcome.output
    assert "Traceback" not in outcome.output
    assert "file a bug" not in outcome.output
    if (outcome.report / "run.json").exists():
        assert set(outcome.statuses.values()) <= {"PASS", "KIT_ERROR"}
        assert "KIT_ERROR" in outcome.statuses.values()
    else:
        assert "M1 could not begin" in outcome.output
    words = " ".join(outcome.output.split())
    assert "`ulimit -n 1024`" in words


@pytest.mark.long
def test_few_file_descriptors_accuse_no_adapter(empty_repository: Repository) -> None:
    accuses_nobody(run(empty_repository, resource.RLIMIT_NOFILE, 44, "--otmcp-reps=1", "--otmcp-suite=normal"))


@pytest.mark.long
@pytest.mark.parametrize("descriptors", [30, 40, 50, pytest.param(60, marks=pytest.mark.weekly)])
def test_however_few_file_descriptors_there_are_nobody_is_accused(
    empty_repository: Repository, descriptors: int
) -> None:
    outcome = run(empty_repository, resource.RLIMIT_NOFILE, descriptors, "--otmcp-reps=1")
    if outcome.code:
        accuses_nobody(outcome)
    else:
        assert set(outcome.statuses.values()) == {"PASS"}


LACKING = """
import errno
import pytest
from pytest_otmcp.session.loop import LoopThread

def lack(self):
    raise OSError(errno.EMFILE, "Too many open files")

@pytest.fixture(autouse=True)
def descriptors(monkeypatch):
    monkeypatch.setattr(LoopThread, "__init__", lack)
"""


@pytest.mark.parametrize("parallel", [(), pytest.param(("-n", "2"), marks=pytest.mark.long)])
def test_a_run_that_cannot_even_begin_ends_in_one_sentence(
    empty_repository: Repository, parallel: tuple[str, ...]
) -> None:
    empty_repository.subject()
    empty_repository.write(conftest_py=LACKING)
    outcome = empty_repository.pytest("--otmcp-reps=1", "-k", "[M1]", *parallel, plugins="xdist")
    assert outcome.code == 3, outcome.output
    assert "M1 could not begin: a process of the kit has no file descriptor left; raise the limit" in outcome.output
    assert "Traceback" not in outcome.output


ACCEPTS_NOTHING = """
import errno
import pytest
from pytest_otmcp.session.loop import LoopThread

@pytest.fixture(autouse=True)
def tap(monkeypatch):
    run = LoopThread.run

    def report(self, work):
        error = OSError(errno.EMFILE, "Too many open files")
        self._loop.call_exception_handler({"message": "socket.accept() out of system resource", "exception": error})
        return run(self, work)

    monkeypatch.setattr(LoopThread, "run", report)
"""


@pytest.mark.long
def test_a_connection_that_the_kit_could_not_accept_makes_its_item_a_fault_of_the_kit(
    empty_repository: Repository,
) -> None:
    empty_repository.subject()
    empty_repository.write(conftest_py=ACCEPTS_NOTHING)
    accuses_nobody(empty_repository.pytest("--otmcp-reps=1", "-k", "[M1]"))


@pytest.mark.long
def test_a_record_that_does_not_fit_on_the_disk_ends_the_run_in_one_sentence(empty_repository: Repository) -> None:
    # The samples of one call are smaller than the limit; the record with its header is not.
    outcome = run(empty_repository, resource.RLIMIT_FSIZE, 6_000, "--otmcp-reps=1", "-k", "[M1]")
    assert outcome.code == 3
    words = " ".join(outcome.output.split())
    assert (
        f"{outcome.report / 'run.json'} cannot be written: a file would be larger than this process may write" in words
    )
    assert "Traceback" not in outcome.output
    assert "VERDICT" not in outcome.output


@pytest.mark.long
def test_samples_that_do_not_fit_into_a_file_are_no_finding(empty_repository: Repository) -> None:
    # The samples of fifty calls are larger than the limit; the rest of the record is not.
    outcome = run(empty_repository, resource.RLIMIT_FSIZE, 20_000, "--otmcp-reps=1", "-k", "[S7]")
    assert outcome.code == 3, outcome.output
    assert outcome.statuses == {"S7": "KIT_ERROR"}
    assert [found["code"] for found in outcome.record["items"][0]["findings"]] == ["exhausted"]
    assert "Traceback" not in outcome.output
    assert "raise the limit, for instance with `ulimit -f unlimited`" in " ".join(outcome.output.split())


@pytest.mark.parametrize("command", [["report", "run.json"], ["explain", "M3"]])
def test_a_command_without_descriptors_says_so_in_one_sentence(tmp_path: Path, command: list[str]) -> None:
    program = (
        "import resource, sys\n"
        "from pytest_otmcp import cli\n"
        "open('run.json', 'w').close()\n"
        "taken = []\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (20, 20))\n"
        "try:\n"
        "    while True: taken.append(open('run.json'))\n"
        "except OSError: pass\n"
        f"sys.exit(cli.main({command!r}))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 3, done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("otmcp: ")
    assert ": a process of the kit has no file descriptor left; raise the limit" in done.stderr
