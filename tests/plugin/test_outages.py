"""An adapter with a few operations is taken through an outage by a run without the requirement suite, and so is its lying twin."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.report.capabilities import earned
from pytest_otmcp.soundness.defect import ADAPTERS, DEFECTS
from pytest_otmcp.soundness.warm_start import WarmStart
from tests.reference_text import reference_text

from .vendor import Outcome, Repository

SUITE = ("--pyargs", "pytest_otmcp.conformance")

CASES = {
    "modbus": ("read_holding write_holding", "MU-14g", "S10 R-modbus", "S10", "WR-001"),
    "mqtt": ("subscribe messages publish", "MU-14gq", "S11 R-mqtt", "S11", "MQT-001"),
    "opcua": ("read_many write", "MU-14go", "S12 R-opcua", "S12", "OUA-001"),
}
"""Operations; the defect that what could not be written is told as written; items with an outage; those that fail, and why."""


EVERY = [pytest.param(name, marks=pytest.mark.long) for name in CASES]

_SHOWN = {"Reading": "earned", "Refusing bad requests": "earned", "Load": "earned", "Surviving outages": "earned"}
GRADES = {
    "modbus": {**_SHOWN, "Writing": "earned", "Write protection": "earned"},
    "mqtt": {**_SHOWN, "Writing": "earned", "Write protection": "earned"},
    # No item writes through an adapter that reads no single node, but for those that must fail.
    "opcua": {
        **_SHOWN,
        "Reading": "not asked",
        "Load": "not asked",
        "Writing": "not asked",
        "Write protection": "not asked",
    },
}
"""Grades of the honest twins; what an adapter has and no item of the benchmark asks for is never called unclaimed."""


def grades(run: Outcome, protocol: str) -> dict[str, str]:
    """Return the grade of each capability, as the report has it."""
    name = protocols()[protocol].name
    return {heading.name: by_family[name].grade.value for heading, by_family in earned(run.record)}


def described(protocol: str, operations: str, words: list[str]) -> str:
    """Return a subject file for the reference adapter of a protocol as one that has these operations alone.

    Args:
        words: the command.
    """
    kept = operations.split()
    tables = re.split(r"^(?=\[adapter\.\w+\]$)", reference_text(), flags=re.MULTILINE)
    (table,) = [text for text in tables if text.startswith(f"[adapter.{protocol}]")]
    known = protocols()[protocol].operations
    lines = [line for line in table.splitlines() if line.partition(" = ")[0] not in {*known} - {*kept}]
    left_out = [name for name, operation in known.items() if name not in kept and not operation.voluntary]
    unclaimed = ", ".join(f'{name} = "has no tool for it"' for name in left_out)
    lines[1] = f"command = {json.dumps(words)}\nunclaimed = {{ {unclaimed} }}"
    return '[subject]\nname = "few operations"\nversion = "1"\n\n' + "\n".join(lines) + "\n"


def outcome(where: Path, warm_start: WarmStart, protocol: str, *program: str) -> Outcome:
    """Run the suite over an adapter of ``CASES``."""
    repository = Repository(where, warm_start)
    repository.write(otmcp_toml=described(protocol, CASES[protocol][0], [*warm_start.python, "-P", "-m", *program]))
    return repository.pytest(*SUITE, "--otmcp-reps=3")


@pytest.mark.parametrize("protocol", EVERY)
def test_who_tells_as_written_what_could_not_be_written_does_not_conform(
    tmp_path: Path, warm_start: WarmStart, protocol: str
) -> None:
    _, lie, _, failing, requirement = CASES[protocol]
    liar = outcome(tmp_path, warm_start, protocol, DEFECTS, lie)
    assert liar.verdict == "NOT CONFORMANT", liar.output
    assert {name for name, status in liar.statuses.items() if status not in ("PASS", "NOT_APPLICABLE")} == {failing}
    assert requirement in liar.output
    assert grades(liar, protocol)["Writing"] == "not earned"


@pytest.mark.parametrize("protocol", EVERY)
@pytest.mark.long
def test_its_honest_twin_conforms(tmp_path: Path, warm_start: WarmStart, protocol: str) -> None:
    honest = outcome(tmp_path, warm_start, protocol, ADAPTERS, protocol)
    assert honest.verdict == "CONFORMANT", honest.output
    away = CASES[protocol][2].split()
    assert {honest.statuses[name] for name in away} == {"PASS"}
    assert grades(honest, protocol) == GRADES[protocol]
