"""The requirement suite and the catalogue agree: each row that is judged has its checks, each check a row and a defect."""

from __future__ import annotations

import pytest
from pytest_otmcp.reference_adapters.defects.table import DEFECTS

from pytest_otmcp.core.matrix import REQUIREMENTS
from pytest_otmcp.protocols.own import OWN
from pytest_otmcp.suite.catalogue import all_tasks
from pytest_otmcp.suite.requirements import Level, catalogue, requirements

CHECKS = {task.id: task for task in all_tasks().values() if task.suite == REQUIREMENTS}


def test_every_check_is_about_one_row_that_is_judged() -> None:
    for name, task in CHECKS.items():
        (row,) = task.requirements
        assert name.partition(".")[0] == row
        assert requirements()[row].not_yet is None, f"{name} judges a row that the catalogue calls not yet judged"


@pytest.mark.parametrize("protocol", OWN)
def test_every_rule_of_a_level_has_a_check_on_the_protocol(protocol: str) -> None:
    needed = [
        row.id for row in catalogue().needs(Level.SILVER, protocol) if row.not_yet is None and row.strength == "MUST"
    ]
    assert [f"{row}.{protocol}" for row in needed if f"{row}.{protocol}" not in CHECKS] == []


def test_every_must_with_a_check_is_noticed_to_be_broken_by_a_defect() -> None:
    killed = {name.partition(".")[0] for defect in DEFECTS.values() if defect.areas for name in defect.items.split()}
    must = {task.requirements[0] for task in CHECKS.values() if requirements()[task.requirements[0]].strength == "MUST"}
    assert sorted(must - killed) == []


def test_a_defect_names_checks_of_its_areas_only() -> None:
    for defect in DEFECTS.values():
        for name in defect.items.split() if defect.areas else ():
            assert name in CHECKS, f"{defect.id} names {name}"
            assert name.partition("-")[0].lower() in defect.areas.split()
