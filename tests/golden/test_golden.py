"""The judgement of every golden record is what the oracles of this checkout find in its history."""

from __future__ import annotations

import gzip
import json

import pytest

from pytest_otmcp.record.reader import open_record
from pytest_otmcp.replay.rejudge import differences

from .files import COMMAND, MACHINE_PATH, names, path_of


def _marks(name: str) -> list[pytest.MarkDecorator]:
    """Return the marks of a record: those of the reference adapters have all items of a protocol."""
    return [pytest.mark.long] if name.startswith("reference-") else []


@pytest.mark.parametrize("name", [pytest.param(name, marks=_marks(name)) for name in names()])
def test_a_golden_record_is_judged_as_before(name: str) -> None:
    path = path_of(name)
    with open_record(path, compressed=True) as stored:
        found = "\n".join(map(str, differences(stored)))
    assert not found, f"'otmcp judge {path}' shows it by item; if it must be so: {COMMAND} {name}\n{found}"


def test_every_recipe_has_its_record_and_every_record_the_items_of_its_recipe() -> None:
    # The recipes know every adapter; judging a record takes none of them.
    from .recipes import recipes

    made = {name: tuple(item["id"] for item in json.loads(_text(name))["items"]) for name in names()}
    assert made == {name: recipe.items for name, recipe in recipes().items()}


def test_no_golden_record_has_a_path_of_the_machine_that_made_it() -> None:
    assert [name for name in names() if MACHINE_PATH.search(_text(name))] == []


def _text(name: str) -> str:
    return gzip.decompress(path_of(name).read_bytes()).decode()
