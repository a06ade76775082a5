"""A clone that is installed as editable, as a contributor has it: the schemas are there, and the first walk leads to its end."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pytest_otmcp.record.json_schema import json_schema
from pytest_otmcp.subject.schema import shipped_text

from .conftest import SCHEMAS
from .test_wheel import run

pytestmark = pytest.mark.long


def test_an_editable_install_builds_the_schemas_into_the_clone(clone: Path) -> None:
    assert [(clone / name).read_text(encoding="utf-8") for name in SCHEMAS] == [json_schema(), shipped_text()]


def follow(clone: Path) -> None:
    """Do what the first walk of CONTRIBUTING.md says, block by block."""
    text = (clone / "CONTRIBUTING.md").read_text(encoding="utf-8")
    row, check, defect, declaration = re.findall(r"^```(?:toml|python)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    [neighbour] = re.findall(r'append\n`(\("[^`]*"\))` to `NEIGHBOURS`', text)
    checks, defects = clone / "conformance/requirements/rd.py", clone / "reference_adapters/defects/areas/rd.py"
    insert(clone / "conformance/requirements.toml", row, before="# -- writing")
    insert(checks, "citing, ", before="exact_or_refused")
    checks.write_text(f"{checks.read_text()}\n\n{check}")
    insert(defects, "import asyncio\n", before="from typing")
    insert(defects, f"{defect}\n\n", before="DEFECTS: ")
    insert(defects, f"{declaration.rstrip()},\n", before='    defect(\n        "MU-07r"')
    insert(clone / "tests/soundness/test_honest.py", f"{neighbour},\n", before=']\n"""Honest adapters, each with')


def insert(file: Path, text: str, *, before: str) -> None:
    """Insert a text before the first place that has these words."""
    head, found, tail = file.read_text(encoding="utf-8").partition(before)
    assert found, f"{file}: {before}"
    file.write_text(f"{head}{text}{found}{tail}", encoding="utf-8")


@pytest.mark.weekly
def test_the_first_walk_leads_to_a_check_that_the_honest_adapter_passes_and_the_defective_one_fails(
    clone: Path,
) -> None:
    follow(clone)
    honest = run(clone, "python", "-m", "pytest", "-q", "--otmcp-only=RD-008")
    assert "1/1 runs passed" in honest.stdout, honest.stdout + honest.stderr
    defective = run(clone, "otmcp", "self-check", "MU-05m")
    assert defective.stdout.splitlines()[-1] == "all as expected", defective.stdout + defective.stderr
    asked = run(clone, "otmcp", "explain", "RD-008.modbus")
    assert "In each answer the value of its own unit." in asked.stdout
    neighbour = run(
        clone, "python", "-m", "pytest", "tests/soundness/test_honest.py", "-q", "-m", "long", "-k", "RD-008"
    )
    assert "1 passed" in neighbour.stdout, neighbour.stdout + neighbour.stderr
    house = run(clone, "python", "-m", "pytest", "tests/house/test_catalogue.py", "tests/house/test_checks.py", "-q")
    failed = re.findall(r"^FAILED \S+::(\w+)", house.stdout, re.MULTILINE)
    assert {*failed} == {
        "test_there_are_as_many_rows_of_each_level_as_there_were",
        "test_a_level_needs_as_many_rows_of_a_protocol_as_it_did",
    }
