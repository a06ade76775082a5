"""Each defect of the catalogue that is noticed fails exactly its items, for exactly its requirements; the others are listed."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest
from pytest_otmcp.reference_adapters.defects.defect import Defect, catalogue_id
from pytest_otmcp.reference_adapters.defects.listing import listing
from pytest_otmcp.reference_adapters.defects.not_yet import GROUPS, NOT_YET, TOTAL
from pytest_otmcp.reference_adapters.defects.table import DEFECTS, PROTOCOLS, REPRESENTATIVE

from pytest_otmcp.soundness.defect import read
from pytest_otmcp.soundness.judging import IMPATIENT, tasks_of
from tests.soundness.conftest import DEFECT, Judge, failing, requirements, words

LONG = sorted(REPRESENTATIVE)[::2]
LISTED = {defect.id: defect for defect in read(listing()).defects}


def marks(defect: Defect) -> list[pytest.MarkDecorator]:
    """Return what decides when a defect is run."""
    if defect.quick:
        return []
    # The variants of a defect are many.
    return [pytest.mark.long, *([] if defect.id in LONG else [pytest.mark.weekly])]


@pytest.mark.parametrize("name", [pytest.param(defect.id, marks=marks(defect)) for defect in DEFECTS.values()])
def test_a_defect_fails_exactly_its_items_for_exactly_its_requirements(judge: Judge, name: str) -> None:
    defect = LISTED[name]
    tasks = " ".join(task.id for task in tasks_of(defect))
    time_scale = IMPATIENT if defect.waits else 1.0
    command = (sys.executable, *DEFECT, name) if defect.cold else None
    results = judge(
        defect.protocol, *DEFECT, name, command=command, tasks=tasks, time_scale=time_scale, named=defect.named
    )
    assert failing(results) == set(defect.items), words(results)
    assert requirements(results) == set(defect.requirements), words(results)
    assert "KIT_ERROR" not in {result["status"] for result in results.values()}


ANYWHERE = [defect for defect in DEFECTS.values() if defect.anywhere]
AT_OTHERS = [(defect.id, protocol) for defect in ANYWHERE for protocol in sorted(PROTOCOLS - {defect.protocol})]
"""Defects that any adapter may have, each at every other protocol."""


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "protocol"),
    [pytest.param(*pair, marks=[pytest.mark.weekly] if number % 9 else []) for number, pair in enumerate(AT_OTHERS)],
)
def test_a_defect_that_any_adapter_may_have_is_noticed_at_every_protocol(
    judge: Judge, name: str, protocol: str
) -> None:
    alone = [task for task in tasks_of(replace(LISTED[name], protocol=protocol)) if task.adapters == (protocol,)]
    tasks = " ".join(next(task.id for task in alone if task.suite == suite) for suite in ("normal", "fault"))
    results = judge(protocol, *DEFECT, name, protocol, tasks=tasks)
    assert failing(results), "not noticed"
    assert requirements(results) <= set(LISTED[name].requirements), words(results)


def test_every_defect_of_the_catalogue_is_noticed_or_listed_with_its_group() -> None:
    unnoticed = [identifier for defects in NOT_YET.values() for identifier in defects]
    known = [*DEFECTS, *unnoticed]
    assert len(known) == len(set(known))
    assert {catalogue_id(identifier) for identifier in known} == {f"MU-{number:02}" for number in range(1, TOTAL + 1)}
    assert NOT_YET.keys() == GROUPS.keys()
