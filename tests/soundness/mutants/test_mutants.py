"""Each defect of the catalogue that is noticed fails exactly its items, for exactly its requirements; the others are listed."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from pytest_otmcp.core.matrix import REQUIREMENTS
from pytest_otmcp.suite.catalogue import all_tasks
from pytest_otmcp.trial.task import Task
from tests.soundness.conftest import IMPATIENT, Judge, failing, requirements, words
from tests.soundness.document import DOCUMENT, with_section

from .mutant import Mutant, catalogue_id
from .not_yet import GROUPS, NOT_YET, TOTAL
from .section import section
from .table import MUTANTS, REPRESENTATIVE

PROGRAM = Path(__file__).parent / "program.py"


WHOLE_MATRIX = "OTMCP_WHOLE_MATRIX" in os.environ


def marks(mutant: Mutant) -> list[pytest.MarkDecorator]:
    """Return what decides when a defect is run."""
    if mutant.quick:
        return []
    if not mutant.areas or mutant.id in REPRESENTATIVE or WHOLE_MATRIX:
        return [pytest.mark.long]
    return [pytest.mark.long, pytest.mark.skip("OTMCP_WHOLE_MATRIX=1 runs every variant of a defect")]


@pytest.mark.parametrize("name", [pytest.param(mutant.id, marks=marks(mutant)) for mutant in MUTANTS.values()])
def test_a_defect_fails_exactly_its_items_for_exactly_its_requirements(judge: Judge, name: str) -> None:
    mutant = MUTANTS[name]
    tasks = " ".join(task.id for task in all_tasks().values() if _is_run(task, mutant))
    time_scale = IMPATIENT if mutant.waits else 1.0
    command = (sys.executable, str(PROGRAM), name) if mutant.cold else None
    results = judge(mutant.protocol, "mutants/program.py", name, command=command, tasks=tasks, time_scale=time_scale)
    assert failing(results) == set(mutant.items.split()), words(results)
    assert requirements(results) == set(mutant.requirements.split()), words(results)
    assert "KIT_ERROR" not in {result["status"] for result in results.values()}


def _is_run(task: Task, mutant: Mutant) -> bool:
    if task.suite == REQUIREMENTS:
        return task.id.partition("-")[0].lower() in mutant.areas.split()
    return not mutant.areas and (mutant.recovers or task.suite != "recovery")


def test_every_defect_of_the_catalogue_is_noticed_or_listed_with_its_group() -> None:
    unnoticed = [identifier for defects in NOT_YET.values() for identifier in defects]
    known = [*MUTANTS, *unnoticed]
    assert len(known) == len(set(known))
    assert {catalogue_id(identifier) for identifier in known} == {f"MU-{number:02}" for number in range(1, TOTAL + 1)}
    assert NOT_YET.keys() == GROUPS.keys()


def test_the_table_in_the_documentation_is_the_one_of_the_declarations() -> None:
    assert with_section("defects", section()) == DOCUMENT.read_text(encoding="utf-8")
