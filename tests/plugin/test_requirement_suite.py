"""The requirement suite on the command line: which checks run, what is said of them, and that they are judged again."""

from __future__ import annotations

import re

import pytest

from pytest_otmcp.cli import main

from .vendor import Repository

SUITE = ("--pyargs", "pytest_otmcp.conformance")


@pytest.mark.long
def test_one_row_runs_on_every_protocol_and_is_judged_again(
    empty_repository: Repository, capsys: pytest.CaptureFixture[str]
) -> None:
    empty_repository.reference_subject()
    outcome = empty_repository.pytest(*SUITE, "--otmcp-only=MCP-004", plugins=None)
    assert outcome.statuses == {f"MCP-004.{protocol}": "PASS" for protocol in ("modbus", "mqtt", "opcua")}
    assert "narrowed: only the suite requirements was asked for" in outcome.output
    # The other items did not run, so the run earns no certificate.
    main(["verify", str(empty_repository.root / "reports" / "latest" / "run.json")])
    assert "judging them again found the same" in capsys.readouterr().out


@pytest.mark.long
def test_one_check_runs_alone(empty_repository: Repository) -> None:
    empty_repository.reference_subject()
    assert empty_repository.pytest(*SUITE, "--otmcp-only=MCP-004.modbus").statuses == {"MCP-004.modbus": "PASS"}


LONG_FORMS = {
    "REC-002.modbus": 50,
    "RD-007.modbus": 30,
    "OUA-006.opcua": 2,
    "SPB-004.mqtt": 2600,
    "WR-010.mqtt": 1,
}
"""Checks, and the calls that their long form makes at least: outages, 2000 registers, 10 000 variables, 2600 messages, a minute of watching."""


@pytest.mark.long
@pytest.mark.parametrize("check", LONG_FORMS)
def test_the_long_form_of_a_check_is_judged_again_in_its_long_form(
    check: str, empty_repository: Repository, capsys: pytest.CaptureFixture[str]
) -> None:
    empty_repository.reference_subject()
    outcome = empty_repository.pytest(*SUITE, f"--otmcp-only={check}", "--otmcp-soak", plugins=None)
    assert outcome.statuses == {check: "PASS"}
    assert outcome.record["settings"]["soak"] is True
    assert len(outcome.record["items"][0]["samples"][0]["calls"]) >= LONG_FORMS[check]
    # The other items did not run, so the run earns no certificate.
    main(["verify", str(empty_repository.root / "reports" / "latest" / "run.json")])
    assert "judging them again found the same" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("MCP-04", "there is no row or check 'MCP-04'; did you mean MCP-004"),
        ("xyzzy", "there is no row or check 'xyzzy'; 'otmcp docs checks' lists them"),
        ("WR-013", "WR-013 has no check of its own; otmcp explain WR-013 says where it is judged"),
    ],
)
def test_a_row_without_a_check_is_one_sentence(empty_repository: Repository, asked: str, said: str) -> None:
    empty_repository.reference_subject()
    outcome = empty_repository.pytest(*SUITE, f"--otmcp-only={asked}")
    assert outcome.code == 2
    assert f"--otmcp-only: {said}" in outcome.output


@pytest.mark.parametrize("named", [".test_requirements", ".test_requirements::test_requirements[MCP-004.modbus]"])
def test_naming_the_requirement_suite_is_not_yet_asking_for_it(empty_repository: Repository, named: str) -> None:
    empty_repository.reference_subject()
    outcome = empty_repository.pytest("--pyargs", f"pytest_otmcp.conformance{named}")
    assert outcome.code == 2
    assert "the requirement suite runs when it is asked for: --otmcp-suite=requirements" in outcome.output


@pytest.mark.long
def test_what_a_run_is_not_about_is_not_counted_among_what_was_collected(empty_repository: Repository) -> None:
    empty_repository.reference_subject()
    assert len(empty_repository.collected(*SUITE)) == 38
    # Those of other rows are deselected, as pytest says.
    told = collect_only(empty_repository, "--otmcp-only=WR-003")
    found = re.search(r"^3/(\d+) tests collected \((\d+) deselected\)", told, re.MULTILINE)
    assert found is not None, told
    assert int(found[1]) - int(found[2]) == 3
    assert "7/38 tests collected (31 deselected)" in collect_only(empty_repository, "--otmcp-suite=fault")


def collect_only(repository: Repository, *options: str) -> str:
    return repository.pytest("--collect-only", "-q", *SUITE, *options).output


@pytest.mark.long
def test_a_bare_run_is_the_benchmark(empty_repository: Repository) -> None:
    empty_repository.reference_subject()
    outcome = empty_repository.pytest(*SUITE, "-k", "[M1]", "--otmcp-reps=1")
    assert outcome.statuses == {"M1": "PASS"}
    assert "(1 of 11 Modbus items passed; " in outcome.output
