"""The judgement of every golden record is what the oracles of this checkout find in its history."""

from __future__ import annotations

import gzip

import pytest

from pytest_otmcp.record.reader import open_record
from pytest_otmcp.replay.rejudge import differences

from .files import COMMAND, MACHINE_PATH, names, path_of

QUICK_BYTES = 40_000
"""Size of a record that takes a tenth of a second; those of the reference adapters, which have all items of a protocol, take two."""


def _marks(name: str) -> list[pytest.MarkDecorator]:
    return [pytest.mark.long] if path_of(name).stat().st_size > QUICK_BYTES else []


@pytest.mark.parametrize("name", [pytest.param(name, marks=_marks(name)) for name in names()])
def test_a_golden_record_is_judged_as_before(name: str) -> None:
    path = path_of(name)
    with open_record(path, compressed=True) as stored:
        found = "\n".join(map(str, differences(stored)))
    assert not found, f"'otmcp judge {path}' shows it by item; if it must be so: {COMMAND} {name}\n{found}"


def test_every_recipe_has_its_record_and_every_record_its_recipe() -> None:
    # The recipes know every adapter; judging a record takes none of them.
    from .recipes import recipes

    assert names() == sorted(recipes())


def test_no_golden_record_has_a_path_of_the_machine_that_made_it() -> None:
    found = {name: MACHINE_PATH.search(gzip.decompress(path_of(name).read_bytes()).decode()) for name in names()}
    assert {name: match[0] for name, match in found.items() if match} == {}
